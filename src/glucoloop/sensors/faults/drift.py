"""Sensor whose error grows with time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.parts.faults import DriftSettings
from glucoloop.sensors.faults.sample_time import checked_sample_time
from glucoloop.sensors.faults.wrapping import AlteredReadings, or_ideal
from glucoloop.sensors.protocol import Reading, Sensor
from glucoloop.units import MIN_PER_H


@pytree
class Drift(AlteredReadings):
    """Adds an error that grows from zero at the onset, in proportion to time."""

    mg_dl_sample: jax.Array | float
    """Growth from one sample to the next."""

    @staticmethod
    def numbers(settings: Mapping[str, Any], sample_time_min: float) -> dict[str, Any]:
        """Fields of the class from settings, which may be arrays of people."""
        return {"mg_dl_sample": settings["mg_dl_h"] * sample_time_min / MIN_PER_H}

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """The reading and the drift since the onset."""
        return Reading(glucose_mg_dl=reading.glucose_mg_dl + self.mg_dl_sample * age, valid=reading.valid)


@checked
def drift(mg_dl_h: float, episodes: Episodes, inner: Sensor | None = None, *, sample_time_min: float = 5.0) -> Drift:
    """Sensor that drifts during the episodes and is correct again after each.

    Parameters
    ----------
    mg_dl_h : float
        Growth of the error in an hour, of either sign.
    episodes : Episodes
    inner : Sensor, optional
        Inner sensor; an ideal one by default.
    sample_time_min : float
        Sample time of the loop.

    Raises
    ------
    ValueError
        For a growth that is not finite or a sample time that is not positive.
    """
    DriftSettings(mg_dl_h=mg_dl_h)
    a_sample = mg_dl_h * checked_sample_time(sample_time_min) / MIN_PER_H
    return Drift(inner=or_ideal(inner), episodes=episodes, mg_dl_sample=a_sample)
