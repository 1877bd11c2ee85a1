"""A number that is no glucose, told as if it were."""

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
    """Tells a number whatever glucose is, and calls it valid."""

    inner: Sensor
    episodes: Episodes
    value: jax.Array | float
    """May be infinite or not a number."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Within:
        """See `Sensor`."""
        return begin(self, glucose_mg_dl, key)

    def read(self, state: Within, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Within, Reading]:
        """Read what is inside, and tell the number in its place while the fault is there."""
        state, age, reading = read_within(self, state, glucose_mg_dl, key)
        there = age >= 0.0
        return state, Reading(
            glucose_mg_dl=jnp.where(there, self.value, reading.glucose_mg_dl), valid=reading.valid | there
        )


@checked
def nonsense(value: float, episodes: Episodes, inner: Sensor | None = None) -> Nonsense:
    """Sensor that tells a number of its own during the episodes: 0, 2000, infinite or none at all."""
    return Nonsense(inner=or_ideal(inner), episodes=episodes, value=float(value))
