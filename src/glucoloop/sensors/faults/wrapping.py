"""Common parts of all sensor faults: an inner sensor, and the episodes of the fault."""

from __future__ import annotations

import jax

from glucoloop.episodes import Faulty, Within, begin
from glucoloop.sensors.ideal import IdealSensor
from glucoloop.sensors.protocol import Reading, Sensor

__all__ = ["Within", "begin", "or_ideal", "read_within"]


def read_within(
    fault: Faulty, state: Within, glucose_mg_dl: jax.Array, key: jax.Array
) -> tuple[Within, jax.Array, Reading]:
    """Read the inner sensor; the age of the fault comes with the reading, -1 while the fault is absent."""
    inner, reading = fault.inner.read(state.inner, glucose_mg_dl, key)
    episode, age = fault.episodes.step(state.episode, key)
    return Within(inner=inner, episode=episode), age, reading


def or_ideal(inner: Sensor | None) -> Sensor:
    """The given sensor, or the ideal one for None."""
    return IdealSensor() if inner is None else inner
