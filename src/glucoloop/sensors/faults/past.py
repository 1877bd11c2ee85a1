"""Buffer of the latest readings, the oldest first, for late and disordered readings."""

from __future__ import annotations

import operator
from typing import Final

import jax
import jax.numpy as jnp

from glucoloop.sensors.protocol import Reading

LONGEST: Final = 288
"""Largest number of samples that are kept: a day of 5-min samples."""


def filled(samples: int, glucose_mg_dl: jax.Array) -> Reading:
    """Buffer ``(samples, ...)`` of a sensor that has read the given glucose for a long time."""
    glucose = jnp.broadcast_to(glucose_mg_dl, (samples, *jnp.shape(glucose_mg_dl)))
    return Reading(glucose_mg_dl=glucose, valid=jnp.ones(glucose.shape, bool))


def joined(past: Reading, newest: Reading) -> Reading:
    """Buffer with the newest reading appended, ``(samples + 1, ...)``."""
    line: Reading = jax.tree.map(lambda old, new: jnp.concatenate([old, new[None]]), past, newest)
    return line


def one_of(line: Reading, index: int) -> Reading:
    """Reading at a position of the buffer."""
    reading: Reading = jax.tree.map(operator.itemgetter(index), line)
    return reading


def without_oldest(line: Reading) -> Reading:
    """Buffer for the next sample, without the oldest reading."""
    rest: Reading = jax.tree.map(lambda readings: readings[1:], line)
    return rest
