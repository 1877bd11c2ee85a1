"""Sensor with a dead time of whole samples."""

from __future__ import annotations

import operator
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.refusal import Refusal
from glucoloop.sensors.protocol import IdealSensor, Reading, Sensor

LONGEST_DEAD_TIME_SAMPLES: Final = 288  # a day of 5-min samples


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


@pytree
class _Line:
    inner: Any
    waiting: Reading
    """Readings that are not yet given, the oldest first."""


@pytree
class DeadTime:
    """Gives the reading of the inner sensor from `samples` ago; before the first such reading, the initial glucose."""

    inner: Sensor
    samples: int = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _Line:
        """A delay line filled with the initial glucose."""
        return _Line(inner=self.inner.init(glucose_mg_dl, key), waiting=filled(self.samples, glucose_mg_dl))

    def read(self, state: _Line, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_Line, Reading]:
        """Append a new reading to the delay line and give the one at its head."""
        inner, newest = self.inner.read(state.inner, glucose_mg_dl, key)
        line = joined(state.waiting, newest)
        return _Line(inner=inner, waiting=without_oldest(line)), one_of(line, 0)


@checked
def dead_time(samples: int, inner: Sensor | None = None) -> DeadTime:
    """Sensor with a dead time of whole samples.

    Raises
    ------
    ValueError
        Unless `samples` is a whole number from 0 to 288.
    """
    if not 0 <= samples <= LONGEST_DEAD_TIME_SAMPLES:
        raise Refusal(f"samples is {samples}; give a whole number from 0 to {LONGEST_DEAD_TIME_SAMPLES}")
    return DeadTime(inner=inner if inner is not None else IdealSensor(), samples=samples)
