"""Constants that can vary from person to person, how they do, their bounds, and the parameters that result.

Varied are the constants of the patient by name, body weight among them. Absorption of insulin can be varied by its rate
as well, ``absorption_rate = 1 / t_maxI``, since that is the quantity whose distribution is published.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple, TypeVar

from glucoloop.patients.component import Constant
from glucoloop.patients.hovorka.equations import HovorkaConstants
from glucoloop.patients.variation import Distribution, refuse_not_positive
from glucoloop.refusal import Refusal

MIN_OF_MEAN: Final = 0.1
"""Minimum value as a fraction of the mean, where one standard deviation below the mean is not positive."""


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


Constants = TypeVar("Constants", bound=HovorkaConstants)

ABSORPTION_TIME: Final = "t_maxI"
ABSORPTION_RATE: Final = "absorption_rate"
UPTAKE_THRESHOLD: Final = "uptake_threshold"
RENAL_THRESHOLD: Final = "renal_threshold"


def nominal_values(person: HovorkaConstants) -> dict[str, float]:
    """All constants that can vary, with the values of a nominal person."""
    values = {name: float(value) for name, value in vars(person).items()}
    return {**values, ABSORPTION_RATE: 1.0 / values[ABSORPTION_TIME]}


def meanings(constants: Iterable[Constant]) -> dict[str, str]:
    """Meaning of what can vary, in words."""
    values = {constant.name: constant.meaning.partition(";")[0] for constant in constants}
    return {**values, ABSORPTION_RATE: "rate of insulin absorption"}


def refuse_impossible(person: HovorkaConstants, varied: Mapping[str, Distribution]) -> None:
    """Refuse distributions around a nominal person that can make an impossible one.

    A constant must stay above 0, the kidney must not excrete glucose while the uptake is reduced for lack of it, and
    absorption is varied by its time or by its rate.
    """
    refuse_not_positive(varied)
    if ABSORPTION_TIME in varied and ABSORPTION_RATE in varied:
        raise Refusal(f"{ABSORPTION_RATE} is 1 / {ABSORPTION_TIME}; vary one of the two")
    threshold = getattr(person, UPTAKE_THRESHOLD, None)
    if threshold is None:
        return
    uptake, renal = (varied.get(name) for name in (UPTAKE_THRESHOLD, RENAL_THRESHOLD))
    most = threshold if uptake is None else uptake.upper
    least = getattr(person, RENAL_THRESHOLD) if renal is None else renal.lower
    if most > least:
        raise Refusal(
            f"{UPTAKE_THRESHOLD} can be {most:g} mmol/l and {RENAL_THRESHOLD} {least:g} mmol/l, but the first must not "
            "exceed the second; narrow their spreads"
        )


def with_values(person: Constants, values: Mapping[str, Any]) -> Constants:
    """Constants of the person or people ``(people,)`` with these values, and those of the nominal person otherwise."""
    constants = dict(values)
    if ABSORPTION_RATE in constants:
        constants[ABSORPTION_TIME] = 1.0 / constants.pop(ABSORPTION_RATE)
    return dataclasses.replace(person, **constants)
