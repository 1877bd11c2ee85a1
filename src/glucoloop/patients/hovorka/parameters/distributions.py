"""Published distributions of a constant between people."""

from __future__ import annotations

from typing import Final, NamedTuple

LEAST_OF_MEAN: Final = 0.1
"""Least value as a fraction of the mean, where one standard deviation below the mean is not positive."""


class Normal(NamedTuple):
    """A normally distributed parameter."""

    parameter: str
    mean: float
    sd: float
    source: str


class Uniform(NamedTuple):
    """A parameter with a uniform distribution between two values."""

    parameter: str
    least: float
    most: float
    source: str


class Lognormal(NamedTuple):
    """A parameter whose logarithm is normally distributed."""

    parameter: str
    median: float
    sd_of_logarithm: float
    source: str
