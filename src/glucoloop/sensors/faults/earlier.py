"""Faults that give an earlier reading: again, late without a notice, or out of order."""

from __future__ import annotations

import math
from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes, Within
from glucoloop.faults import OutOfOrderSettings, RepeatedSettings
from glucoloop.refusal import Refusal
from glucoloop.sensors.delay import LONGEST_DEAD_TIME_SAMPLES, filled, joined, one_of, without_oldest
from glucoloop.sensors.faults.wrapping import FaultySensor, read_within
from glucoloop.sensors.protocol import Reading, Sensor, or_ideal


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
        reported: Reading = jax.tree.map(lambda held, new: jnp.where(age > 0.0, held, new), state.held, newest)
        return _Held(within=within, held=reported), reported


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
        reported: Reading = jax.tree.map(lambda last, new: jnp.where(again, last, new), state.last, newest)
        return _Repeats(within=within, last=reported, told=jnp.where(again, state.told + 1.0, 1.0)), reported


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


_HAIR: Final = 1e-9  # of a sample: whole minutes over whole minutes may come out just above a whole number
_WHICH: Final = 1  # sets the choice of a reading apart from the draws of an episode


@pytree
class _State:
    within: Within
    past: Reading


@pytree
class Late(FaultySensor):
    """Gives the reading from some samples ago; before the first such reading, the initial glucose."""

    samples: int = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State of the inner sensor and of the fault, with the initial glucose as past readings."""
        return _State(within=super().init(glucose_mg_dl, key), past=filled(self.samples, glucose_mg_dl))

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, and give an older reading while the fault is present."""
        within, age, newest = read_within(self, state.within, glucose_mg_dl, key)
        line = joined(state.past, newest)
        reported: Reading = jax.tree.map(lambda old, new: jnp.where(age >= 0.0, old, new), one_of(line, 0), newest)
        return _State(within=within, past=without_oldest(line)), reported


@checked
def late(samples: int, episodes: Episodes, inner: Sensor | None = None) -> Late:
    """Sensor whose readings arrive late by whole samples during the episodes.

    A dead time that is always there is `dead_time`.

    Raises
    ------
    ValueError
        Unless `samples` is a whole number from 1 to 288.
    """
    if not 1 <= samples <= LONGEST_DEAD_TIME_SAMPLES:
        raise Refusal(
            f"a delay of {samples} samples is not possible; give a whole number from 1 to {LONGEST_DEAD_TIME_SAMPLES}"
        )
    return Late(inner=or_ideal(inner), episodes=episodes, samples=samples)


def late_by(delay_min: float, episodes: Episodes, inner: Sensor | None = None, *, sample_time_min: float = 5.0) -> Late:
    """Sensor whose readings are late by some minutes, rounded up to samples; see `late`."""
    delay = delay_min / sample_time_min
    return late(math.ceil(delay - _HAIR) if math.isfinite(delay) else 0, episodes, inner)


@pytree
class OutOfOrder(FaultySensor):
    """Gives one of the latest readings, each with the same probability and drawn anew at each sample."""

    among: int = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State of the inner sensor and of the fault, with the initial glucose as past readings."""
        return _State(within=super().init(glucose_mg_dl, key), past=filled(self.among - 1, glucose_mg_dl))

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, and give one of the latest readings while the fault is present."""
        within, age, newest = read_within(self, state.within, glucose_mg_dl, key)
        line = joined(state.past, newest)
        choice_key = jax.random.fold_in(self.episodes.own(key), _WHICH)
        drawn = self.among * jax.random.uniform(choice_key, age.shape, age.dtype)
        reported = newest
        for place in range(self.among - 1):
            # native code cannot take a random place of an array, but it can choose between values
            chosen = (age >= 0.0) & (drawn >= place) & (drawn < place + 1)
            reported = jax.tree.map(
                lambda old, so_far, chosen=chosen: jnp.where(chosen, old, so_far), one_of(line, place), reported
            )
        return _State(within=within, past=without_oldest(line)), reported


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
