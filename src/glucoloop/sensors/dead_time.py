"""A sensor that answers late by whole samples."""

from __future__ import annotations

import operator
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.sensors.ideal import IdealSensor
from glucoloop.sensors.protocol import Reading, Sensor

_LONGEST: Final = 288  # a day of 5-min samples


@pytree
class _Line:
    inner: Any
    waiting: Reading
    """Readings not yet told, the oldest first."""


@pytree
class DeadTime:
    """Tells what the sensor inside read `samples` ago; before the first such reading, glucose at the start."""

    inner: Sensor
    samples: int = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _Line:
        """A line filled with glucose at the start."""
        glucose = jnp.broadcast_to(glucose_mg_dl, (self.samples, *jnp.shape(glucose_mg_dl)))
        return _Line(
            inner=self.inner.init(glucose_mg_dl, key),
            waiting=Reading(glucose_mg_dl=glucose, valid=jnp.ones(glucose.shape, bool)),
        )

    def read(self, state: _Line, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_Line, Reading]:
        """Put a new reading at the end of the line and tell the one at its head."""
        inner, newest = self.inner.read(state.inner, glucose_mg_dl, key)
        line = jax.tree.map(lambda waiting, new: jnp.concatenate([waiting, new[None]]), state.waiting, newest)
        told: Reading = jax.tree.map(operator.itemgetter(0), line)
        return _Line(inner=inner, waiting=jax.tree.map(lambda readings: readings[1:], line)), told


@checked
def dead_time(samples: int, inner: Sensor | None = None) -> DeadTime:
    """Sensor with a dead time of whole samples.

    Raises
    ------
    ValueError
        Unless `samples` is a whole number from 0 to 288.
    """
    if not 0 <= samples <= _LONGEST:
        raise ValueError(f"a dead time of {samples} samples is not possible; give a whole number from 0 to {_LONGEST}")
    return DeadTime(inner=inner if inner is not None else IdealSensor(), samples=samples)
