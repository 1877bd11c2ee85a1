"""Common parts of all sensor faults: an inner sensor, and the episodes of the fault."""

from __future__ import annotations

from typing import Any, Protocol

import jax

from glucoloop._pytree import pytree
from glucoloop.episodes import Episode, Episodes
from glucoloop.sensors.ideal import IdealSensor
from glucoloop.sensors.protocol import Reading, Sensor


class Faulty(Protocol):
    """Protocol of a sensor with a fault."""

    @property
    def inner(self) -> Sensor:
        """Sensor that the fault acts on."""
        ...

    @property
    def episodes(self) -> Episodes:
        """Episodes during which the fault is present."""
        ...


@pytree
class Within:
    """State of the inner sensor, and of the episodes of the fault."""

    inner: Any
    episode: Episode


def begin(fault: Faulty, glucose_mg_dl: jax.Array, key: jax.Array) -> Within:
    """State before the first reading.

    The inner sensor gets the same key as without the fault, so its noise is the same.
    """
    return Within(inner=fault.inner.init(glucose_mg_dl, key), episode=fault.episodes.init(glucose_mg_dl, key))


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
