"""Measuring range of a sensor: readings beyond it are given as its ends."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes, always
from glucoloop.parts.faults import SaturationSettings
from glucoloop.sensors.faults.wrapping import AlteredReadings, or_ideal
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class Saturation(AlteredReadings):
    """Clips readings to a range; NaN stays NaN."""

    low_mg_dl: jax.Array | float
    high_mg_dl: jax.Array | float

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """The reading, clipped to the range."""
        glucose = jnp.clip(reading.glucose_mg_dl, self.low_mg_dl, self.high_mg_dl)
        return Reading(glucose_mg_dl=glucose, valid=reading.valid)


@checked
def saturation(
    low_mg_dl: float = 40.0,
    high_mg_dl: float = 400.0,
    episodes: Episodes | None = None,
    inner: Sensor | None = None,
) -> Saturation:
    """Sensor with a limited measuring range.

    Parameters
    ----------
    low_mg_dl, high_mg_dl : float
        Ends of the range; the defaults are the range in which continuous glucose monitors give a number.
    episodes : Episodes, optional
        Episodes of the fault; by default from the first sample to the last.
    inner : Sensor, optional
        Inner sensor; an ideal one by default.

    Raises
    ------
    ValueError
        Unless ``0 <= low < high``, both finite.
    """
    SaturationSettings(low_mg_dl=low_mg_dl, high_mg_dl=high_mg_dl)
    when = always() if episodes is None else episodes
    return Saturation(inner=or_ideal(inner), episodes=when, low_mg_dl=float(low_mg_dl), high_mg_dl=float(high_mg_dl))
