"""Readings that do not arrive.

About 90 % of the disconnections of a sensor in 72 people lasted less than 20 min: abstract of A. Facchinetti,
S. Del Favero, G. Sparacino, C. Cobelli, "Modeling transient disconnections and compression artifacts of continuous
glucose sensors", Diabetes Technol. Ther. 18, 264-272, 2016.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.sensors.faults.wrapping import Within, begin, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class Missing:
    """Gives no reading, and marks it as not valid."""

    inner: Sensor
    episodes: Episodes

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Within:
        """State of the inner sensor and of the fault before the first reading."""
        return begin(self, glucose_mg_dl, key)

    def read(self, state: Within, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Within, Reading]:
        """Read the inner sensor, and drop the reading while the fault is present."""
        state, age, reading = read_within(self, state, glucose_mg_dl, key)
        lost = age >= 0.0
        return state, Reading(
            glucose_mg_dl=jnp.where(lost, jnp.nan, reading.glucose_mg_dl), valid=reading.valid & ~lost
        )


@checked
def missing(episodes: Episodes, inner: Sensor | None = None) -> Missing:
    """Sensor whose readings do not arrive during the episodes."""
    return Missing(inner=or_ideal(inner), episodes=episodes)
