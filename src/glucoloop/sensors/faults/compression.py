"""Readings that fall because the person lies on the sensor.

The effect is a first-order system driven by a rectangular function, as in A. Facchinetti, S. Del Favero, G. Sparacino,
C. Cobelli, "Modeling transient disconnections and compression artifacts of continuous glucose sensors", Diabetes
Technol. Ther. 18, 264-272, 2016. Its abstract gives for Dexcom G4 sensors a median duration of 45 min (30 to 70 min
from the 5th to the 95th percentile) and a median amplitude of 24 mg/dl (10 to 48 mg/dl). Here the fall is a fraction of
the reading, so that it never exceeds the reading.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes, Within
from glucoloop.faults import CompressionSettings
from glucoloop.sensors.faults.wrapping import FaultySensor, read_within
from glucoloop.sensors.protocol import Reading, Sensor, checked_sample_time, or_ideal

_NOTHING: Final = 1e-4  # of a reading: far below what a sensor resolves


@pytree
class _State:
    within: Within
    fall: jax.Array
    """Fraction of the reading that is lost."""


@pytree
class Compression(FaultySensor):
    """Gives ``(1 - fall) * reading``; the fall goes to its depth and back as a first-order system.

    A fall that has gone back to a ten-thousandth of the reading is over.
    """

    depth: jax.Array | float
    """Fraction of the reading that is lost in the end."""
    left: jax.Array | float
    """Share of the remaining way that is left after a sample: ``exp(-sample time / time constant)``."""

    @staticmethod
    def numbers(settings: Mapping[str, Any], sample_time_min: float) -> dict[str, Any]:
        """Fields of the class from settings, which may be arrays of people."""
        return {"depth": settings["depth"], "left": np.exp(-sample_time_min / settings["tau_min"])}

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State without compression."""
        return _State(within=super().init(glucose_mg_dl, key), fall=jnp.zeros_like(glucose_mg_dl))

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, and give the part of the reading that is not lost."""
        within, age, reading = read_within(self, state.within, glucose_mg_dl, key)
        there = age >= 0.0
        goal = jnp.where(there, self.depth, 0.0)
        fall = goal + self.left * (state.fall - goal)
        fall = jnp.where(there | (fall > _NOTHING), fall, 0.0)
        glucose = reading.glucose_mg_dl
        reported = jnp.where(fall > 0.0, glucose - fall * glucose, glucose)
        return _State(within=within, fall=fall), Reading(glucose_mg_dl=reported, valid=reading.valid)


@checked
def compression(
    depth: float,
    episodes: Episodes,
    inner: Sensor | None = None,
    *,
    tau_min: float = 10.0,
    sample_time_min: float = 5.0,
) -> Compression:
    """Sensor whose readings fall during the episodes and recover after each.

    Parameters
    ----------
    depth : float
        Fraction of the reading that is lost in the end, above 0 and up to 1.
    episodes : Episodes
        Episodes of compression. The onset is the first affected sample; its fall is that after one sample time.
    tau_min : float
        Time constant of fall and recovery. The default is a choice: nearly the full depth is reached within the median
        duration of the source.

    Raises
    ------
    ValueError
        For a depth that is no fraction, or a time that is not positive and finite.
    """
    CompressionSettings(depth=depth, tau_min=tau_min)
    left = math.exp(-checked_sample_time(sample_time_min) / tau_min)
    return Compression(inner=or_ideal(inner), episodes=episodes, depth=float(depth), left=left)
