"""Sensor with a wrong calibration."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes, always
from glucoloop.registry.fault_settings import CalibrationSettings
from glucoloop.sensors.faults.wrapping import Within, begin, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class Calibration:
    """Gives ``gain * reading + offset``."""

    inner: Sensor
    episodes: Episodes
    gain: jax.Array | float
    offset_mg_dl: jax.Array | float

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Within:
        """State of the inner sensor and of the fault before the first reading."""
        return begin(self, glucose_mg_dl, key)

    def read(self, state: Within, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Within, Reading]:
        """Read the inner sensor, and apply gain and offset while the fault is present."""
        state, age, reading = read_within(self, state, glucose_mg_dl, key)
        glucose = reading.glucose_mg_dl
        told = jnp.where(age >= 0.0, self.gain * glucose + self.offset_mg_dl, glucose)
        return state, Reading(glucose_mg_dl=told, valid=reading.valid)


@checked
def calibration(
    gain: float = 1.0, offset_mg_dl: float = 0.0, episodes: Episodes | None = None, inner: Sensor | None = None
) -> Calibration:
    """Sensor with an error of gain and offset.

    Parameters
    ----------
    gain : float
        Factor from the inner reading to the given one.
    offset_mg_dl : float
        Offset of the given reading, of either sign.
    episodes : Episodes, optional
        Episodes of the fault; by default from the first sample to the last.
    inner : Sensor, optional
        Inner sensor; an ideal one by default.

    Raises
    ------
    ValueError
        For a gain that is not positive, or a number that is not finite.
    """
    CalibrationSettings(gain, offset_mg_dl)
    when = always() if episodes is None else episodes
    return Calibration(inner=or_ideal(inner), episodes=when, gain=gain, offset_mg_dl=offset_mg_dl)
