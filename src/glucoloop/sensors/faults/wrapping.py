"""What all sensor faults have in common: a sensor inside, and times at which the fault is there."""

from __future__ import annotations

from typing import Any, Protocol

import jax

from glucoloop._pytree import pytree
from glucoloop.episodes import Episode, Episodes
from glucoloop.sensors.ideal import IdealSensor
from glucoloop.sensors.protocol import Reading, Sensor


class Faulty(Protocol):
    """A sensor with a fault."""

    @property
    def inner(self) -> Sensor:
        """What it is a fault of."""
        ...

    @property
    def episodes(self) -> Episodes:
        """When it is there."""
        ...


@pytree
class Within:
    """State of the sensor inside, and where the fault stands."""

    inner: Any
    episode: Episode


def begin(fault: Faulty, glucose_mg_dl: jax.Array, key: jax.Array) -> Within:
    """Before the first reading. The sensor inside gets the key as it is, so that a fault does not disturb it."""
    return Within(inner=fault.inner.init(glucose_mg_dl, key), episode=fault.episodes.init(glucose_mg_dl, key))


def read_within(
    fault: Faulty, state: Within, glucose_mg_dl: jax.Array, key: jax.Array
) -> tuple[Within, jax.Array, Reading]:
    """Read the sensor inside; the age of the fault comes with it, -1 if there is none."""
    inner, reading = fault.inner.read(state.inner, glucose_mg_dl, key)
    episode, age = fault.episodes.step(state.episode, key)
    return Within(inner=inner, episode=episode), age, reading


def or_ideal(inner: Sensor | None) -> Sensor:
    """A given sensor, or the ideal one."""
    return IdealSensor() if inner is None else inner
