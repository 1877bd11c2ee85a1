"""Readings that arrive out of order."""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.parts.faults import OutOfOrderSettings
from glucoloop.sensors.faults.past import filled, joined, one_of, without_oldest
from glucoloop.sensors.faults.wrapping import Within, begin, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor

_WHICH: Final = 1  # sets the choice of a reading apart from the draws of an episode


@pytree
class _State:
    within: Within
    past: Reading


@pytree
class OutOfOrder:
    """Gives one of the latest readings, each with the same probability and drawn anew at each sample."""

    inner: Sensor
    episodes: Episodes
    among: int = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State of the inner sensor and of the fault, with the initial glucose as past readings."""
        return _State(within=begin(self, glucose_mg_dl, key), past=filled(self.among - 1, glucose_mg_dl))

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, and give one of the latest readings while the fault is present."""
        within, age, newest = read_within(self, state.within, glucose_mg_dl, key)
        line = joined(state.past, newest)
        own = jax.random.fold_in(self.episodes.own(key), _WHICH)
        drawn = self.among * jax.random.uniform(own, age.shape, age.dtype)
        told = newest
        for place in range(self.among - 1):
            # native code cannot take a random place of an array, but it can choose between values
            here = (age >= 0.0) & (drawn >= place) & (drawn < place + 1)
            told = jax.tree.map(lambda old, so_far, here=here: jnp.where(here, old, so_far), one_of(line, place), told)
        return _State(within=within, past=without_oldest(line)), told


@checked
def out_of_order(among: int, episodes: Episodes, inner: Sensor | None = None) -> OutOfOrder:
    """Sensor that gives a random one of its latest readings during the episodes.

    Raises
    ------
    ValueError
        Unless `among` is a whole number from 2 to 48.
    """
    OutOfOrderSettings(among=among)
    return OutOfOrder(inner=or_ideal(inner), episodes=episodes, among=among)
