"""Faults that give an earlier reading again."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes, Within
from glucoloop.parts.faults import RepeatedSettings
from glucoloop.sensors.faults.wrapping import FaultySensor, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor


@pytree
class _Held:
    within: Within
    held: Reading


@pytree
class Stuck(FaultySensor):
    """Repeats the reading at which the fault began."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _Held:
        """State that holds the initial glucose until there is a reading."""
        held = Reading(glucose_mg_dl=glucose_mg_dl, valid=jnp.ones(jnp.shape(glucose_mg_dl), bool))
        return _Held(within=super().init(glucose_mg_dl, key), held=held)

    def read(self, state: _Held, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_Held, Reading]:
        """Read the inner sensor, and give the held reading while the fault is present."""
        within, age, newest = read_within(self, state.within, glucose_mg_dl, key)
        told: Reading = jax.tree.map(lambda held, new: jnp.where(age > 0.0, held, new), state.held, newest)
        return _Held(within=within, held=told), told


@checked
def stuck(episodes: Episodes, inner: Sensor | None = None) -> Stuck:
    """Sensor whose reading stays during each episode at its value when the episode began."""
    return Stuck(inner=or_ideal(inner), episodes=episodes)


@pytree
class _Repeats:
    within: Within
    last: Reading
    told: jax.Array
    """Number of times that the present reading has been given."""


@pytree
class Repeated(FaultySensor):
    """Gives each reading several times; the first is that of the onset."""

    times: jax.Array | float

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _Repeats:
        """State before any reading has been given."""
        last = Reading(glucose_mg_dl=glucose_mg_dl, valid=jnp.ones(jnp.shape(glucose_mg_dl), bool))
        return _Repeats(within=super().init(glucose_mg_dl, key), last=last, told=jnp.zeros_like(glucose_mg_dl))

    def read(self, state: _Repeats, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_Repeats, Reading]:
        """Read the inner sensor, and repeat the last reading while the fault is present."""
        within, age, newest = read_within(self, state.within, glucose_mg_dl, key)
        again = (age > 0.0) & (state.told < self.times)
        told: Reading = jax.tree.map(lambda last, new: jnp.where(again, last, new), state.last, newest)
        return _Repeats(within=within, last=told, told=jnp.where(again, state.told + 1.0, 1.0)), told


@checked
def repeated(times: int, episodes: Episodes, inner: Sensor | None = None) -> Repeated:
    """Sensor that gives each reading several times during the episodes.

    Raises
    ------
    ValueError
        Unless `times` is a whole number of 2 or more.
    """
    RepeatedSettings(times=times)
    return Repeated(inner=or_ideal(inner), episodes=episodes, times=float(times))
