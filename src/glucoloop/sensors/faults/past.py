"""The latest readings, the oldest first: what late and disordered readings are taken from."""

from __future__ import annotations

import operator
from typing import Final

import jax
import jax.numpy as jnp

from glucoloop.sensors.protocol import Reading

LONGEST: Final = 288
"""Samples that are kept at most; a day of 5-min samples."""


def filled(samples: int, glucose_mg_dl: jax.Array) -> Reading:
    """Readings ``(samples, ...)`` of a sensor that has long been seeing the given glucose."""
    glucose = jnp.broadcast_to(glucose_mg_dl, (samples, *jnp.shape(glucose_mg_dl)))
    return Reading(glucose_mg_dl=glucose, valid=jnp.ones(glucose.shape, bool))


def joined(past: Reading, newest: Reading) -> Reading:
    """With the newest at the end, ``(samples + 1, ...)``."""
    line: Reading = jax.tree.map(lambda old, new: jnp.concatenate([old, new[None]]), past, newest)
    return line


def one_of(line: Reading, index: int) -> Reading:
    """A reading by its place."""
    reading: Reading = jax.tree.map(operator.itemgetter(index), line)
    return reading


def without_oldest(line: Reading) -> Reading:
    """What is kept for the next sample."""
    rest: Reading = jax.tree.map(lambda readings: readings[1:], line)
    return rest
