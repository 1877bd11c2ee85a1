"""Measuring range of a sensor: readings beyond it are given as its ends."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes, always
from glucoloop.registry.fault_settings import SaturationSettings
from glucoloop.sensors.faults.wrapping import Within, begin, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class Saturation:
    """Clips readings to a range; NaN stays NaN."""

    inner: Sensor
    episodes: Episodes
    low_mg_dl: jax.Array | float
    high_mg_dl: jax.Array | float

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Within:
        """State of the inner sensor and of the fault before the first reading."""
        return begin(self, glucose_mg_dl, key)

    def read(self, state: Within, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Within, Reading]:
        """Read the inner sensor, and clip the reading while the fault is present."""
        state, age, reading = read_within(self, state, glucose_mg_dl, key)
        glucose = reading.glucose_mg_dl
        told = jnp.where(age >= 0.0, jnp.clip(glucose, self.low_mg_dl, self.high_mg_dl), glucose)
        return state, Reading(glucose_mg_dl=told, valid=reading.valid)


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
    SaturationSettings(low_mg_dl, high_mg_dl)
    when = always() if episodes is None else episodes
    return Saturation(inner=or_ideal(inner), episodes=when, low_mg_dl=float(low_mg_dl), high_mg_dl=float(high_mg_dl))
