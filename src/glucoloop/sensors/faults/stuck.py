"""A sensor that stays where it was."""

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
    """Tells on and on what it read when the fault began."""

    inner: Sensor
    episodes: Episodes

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """Glucose at the start is held until there is something to hold."""
        held = Reading(glucose_mg_dl=glucose_mg_dl, valid=jnp.ones(jnp.shape(glucose_mg_dl), bool))
        return _State(within=begin(self, glucose_mg_dl, key), held=held)

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read what is inside, and tell what is held while the fault is there."""
        within, age, newest = read_within(self, state.within, glucose_mg_dl, key)
        told: Reading = jax.tree.map(lambda held, new: jnp.where(age > 0.0, held, new), state.held, newest)
        return _State(within=within, held=told), told


@checked
def stuck(episodes: Episodes, inner: Sensor | None = None) -> Stuck:
    """Sensor that stays during each episode at what it read when it began."""
    return Stuck(inner=or_ideal(inner), episodes=episodes)
