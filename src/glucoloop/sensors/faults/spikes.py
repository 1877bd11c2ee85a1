"""Readings that are off by a fixed amount, most often for a single sample."""

from __future__ import annotations

import jax

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.parts.faults import SpikesSettings
from glucoloop.sensors.faults.wrapping import AlteredReadings, or_ideal
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class Spikes(AlteredReadings):
    """Adds a fixed amount, of either sign, to the reading."""

    size_mg_dl: jax.Array | float

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """The reading and the fixed amount."""
        return Reading(glucose_mg_dl=reading.glucose_mg_dl + self.size_mg_dl, valid=reading.valid)


@checked
def spikes(size_mg_dl: float, episodes: Episodes, inner: Sensor | None = None) -> Spikes:
    """Sensor whose readings are off by a fixed amount during the episodes.

    Raises
    ------
    ValueError
        For a size that is not finite.
    """
    SpikesSettings(size_mg_dl=size_mg_dl)
    return Spikes(inner=or_ideal(inner), episodes=episodes, size_mg_dl=float(size_mg_dl))
