"""Sensor whose reading stays constant."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.sensors.faults.wrapping import Within, begin, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class _State:
    within: Within
    held: Reading


@pytree
class Stuck:
    """Repeats the reading at which the fault began."""

    inner: Sensor
    episodes: Episodes

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State that holds the initial glucose until there is a reading."""
        held = Reading(glucose_mg_dl=glucose_mg_dl, valid=jnp.ones(jnp.shape(glucose_mg_dl), bool))
        return _State(within=begin(self, glucose_mg_dl, key), held=held)

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, and give the held reading while the fault is present."""
        within, age, newest = read_within(self, state.within, glucose_mg_dl, key)
        told: Reading = jax.tree.map(lambda held, new: jnp.where(age > 0.0, held, new), state.held, newest)
        return _State(within=within, held=told), told


@checked
def stuck(episodes: Episodes, inner: Sensor | None = None) -> Stuck:
    """Sensor whose reading stays during each episode at its value when the episode began."""
    return Stuck(inner=or_ideal(inner), episodes=episodes)
