"""Sensor whose error grows with time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.registry.fault_settings import DriftSettings
from glucoloop.sensors.faults.sample_time import checked_sample_time
from glucoloop.sensors.faults.wrapping import Within, begin, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor
from glucoloop.units import MIN_PER_H


@pytree
class Drift:
    """Adds an error that grows from zero at the onset, in proportion to time."""

    inner: Sensor
    episodes: Episodes
    mg_dl_sample: jax.Array | float
    """Growth from one sample to the next."""

    @staticmethod
    def numbers(settings: Mapping[str, Any], sample_time_min: float) -> dict[str, Any]:
        """Fields of the class from settings, which may be arrays of people."""
        return {"mg_dl_sample": settings["mg_dl_h"] * sample_time_min / MIN_PER_H}

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Within:
        """State of the inner sensor and of the fault before the first reading."""
        return begin(self, glucose_mg_dl, key)

    def read(self, state: Within, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Within, Reading]:
        """Read the inner sensor, and add the drift while the fault is present."""
        state, age, reading = read_within(self, state, glucose_mg_dl, key)
        glucose = reading.glucose_mg_dl
        told = jnp.where(age >= 0.0, glucose + self.mg_dl_sample * age, glucose)
        return state, Reading(glucose_mg_dl=told, valid=reading.valid)


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
    DriftSettings(mg_dl_h)
    a_sample = mg_dl_h * checked_sample_time(sample_time_min) / MIN_PER_H
    return Drift(inner=or_ideal(inner), episodes=episodes, mg_dl_sample=a_sample)
