"""Readings that are off by a fixed amount, most often for a single sample."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.registry.fault_settings import SpikesSettings
from glucoloop.sensors.faults.wrapping import Within, begin, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class Spikes:
    """Adds a fixed amount, of either sign, to the reading."""

    inner: Sensor
    episodes: Episodes
    size_mg_dl: jax.Array | float

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Within:
        """State of the inner sensor and of the fault before the first reading."""
        return begin(self, glucose_mg_dl, key)

    def read(self, state: Within, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Within, Reading]:
        """Read the inner sensor, and add the fixed amount while the fault is present."""
        state, age, reading = read_within(self, state, glucose_mg_dl, key)
        glucose = reading.glucose_mg_dl
        told = jnp.where(age >= 0.0, glucose + self.size_mg_dl, glucose)
        return state, Reading(glucose_mg_dl=told, valid=reading.valid)


@checked
def spikes(size_mg_dl: float, episodes: Episodes, inner: Sensor | None = None) -> Spikes:
    """Sensor whose readings are off by a fixed amount during the episodes.

    Raises
    ------
    ValueError
        For a size that is not finite.
    """
    SpikesSettings(size_mg_dl)
    return Spikes(inner=or_ideal(inner), episodes=episodes, size_mg_dl=float(size_mg_dl))
