"""Common parts of all sensor faults: an inner sensor, and the episodes of the fault."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.episodes import Episodes, Within, begin
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class FaultySensor:
    """A sensor with a fault around another one."""

    inner: Sensor
    episodes: Episodes

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Any:
        """State of the inner sensor and of the fault before the first reading."""
        return begin(self.inner, self.episodes, glucose_mg_dl, key)


def read_within(
    fault: FaultySensor, state: Within, glucose_mg_dl: jax.Array, key: jax.Array
) -> tuple[Within, jax.Array, Reading]:
    """Read the inner sensor; the age of the fault comes with the reading, -1 while the fault is absent."""
    inner, reading = fault.inner.read(state.inner, glucose_mg_dl, key)
    episode, age = fault.episodes.step(state.episode, key)
    return Within(inner=inner, episode=episode), age, reading


@pytree
class AlteredReadings(FaultySensor):
    """A fault that changes single readings; a subclass has its numbers as fields, and the method `altered`."""

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """Reading that is given in place of the inner sensor's; `age` counts the samples since the fault began."""
        raise NotImplementedError

    def read(self, state: Within, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Within, Reading]:
        """Read the inner sensor, and give the altered reading while the fault is present."""
        state, age, reading = read_within(self, state, glucose_mg_dl, key)
        there = age >= 0.0

        def while_there(altered: Any, inner: Any) -> Any:
            return inner if altered is inner else jnp.where(there, altered, inner)

        reported: Reading = jax.tree.map(while_there, self.altered(reading, age), reading)
        return state, reported
