"""Readings that have nothing to do with glucose and are given as valid."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.sensors.faults.wrapping import Within, begin, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class Nonsense:
    """Gives a fixed number whatever glucose is, and marks it as valid."""

    inner: Sensor
    episodes: Episodes
    value: jax.Array | float
    """Number that is given; it may be infinite or not a number."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Within:
        """State of the inner sensor and of the fault before the first reading."""
        return begin(self, glucose_mg_dl, key)

    def read(self, state: Within, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Within, Reading]:
        """Read the inner sensor, and give the fixed number in its place while the fault is present."""
        state, age, reading = read_within(self, state, glucose_mg_dl, key)
        there = age >= 0.0
        return state, Reading(
            glucose_mg_dl=jnp.where(there, self.value, reading.glucose_mg_dl), valid=reading.valid | there
        )


@checked
def nonsense(value: float, episodes: Episodes, inner: Sensor | None = None) -> Nonsense:
    """Sensor that gives a fixed number during the episodes, for example 0, 2000, infinity or NaN."""
    return Nonsense(inner=or_ideal(inner), episodes=episodes, value=float(value))
