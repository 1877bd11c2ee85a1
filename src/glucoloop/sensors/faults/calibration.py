"""Sensor with a wrong calibration."""

from __future__ import annotations

import jax

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes, always
from glucoloop.parts.faults import CalibrationSettings
from glucoloop.sensors.faults.wrapping import AlteredReadings, or_ideal
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class Calibration(AlteredReadings):
    """Gives ``gain * reading + offset``."""

    gain: jax.Array | float
    offset_mg_dl: jax.Array | float

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """Gain and offset applied to the reading."""
        glucose = self.gain * reading.glucose_mg_dl + self.offset_mg_dl
        return Reading(glucose_mg_dl=glucose, valid=reading.valid)


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
    CalibrationSettings(gain=gain, offset_mg_dl=offset_mg_dl)
    when = always() if episodes is None else episodes
    return Calibration(inner=or_ideal(inner), episodes=when, gain=gain, offset_mg_dl=offset_mg_dl)
