"""Readings that arrive late without a notice."""

from __future__ import annotations

import math
from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.refusal import Refusal
from glucoloop.sensors.faults.past import LONGEST, filled, joined, one_of, without_oldest
from glucoloop.sensors.faults.wrapping import Within, begin, or_ideal, read_within
from glucoloop.sensors.protocol import Reading, Sensor

_HAIR: Final = 1e-9  # of a sample: whole minutes over whole minutes may come out just above a whole number


@pytree
class _State:
    within: Within
    past: Reading


@pytree
class Late:
    """Gives the reading from some samples ago; before the first such reading, the initial glucose."""

    inner: Sensor
    episodes: Episodes
    samples: int = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State of the inner sensor and of the fault, with the initial glucose as past readings."""
        return _State(within=begin(self, glucose_mg_dl, key), past=filled(self.samples, glucose_mg_dl))

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, and give an older reading while the fault is present."""
        within, age, newest = read_within(self, state.within, glucose_mg_dl, key)
        line = joined(state.past, newest)
        told: Reading = jax.tree.map(lambda old, new: jnp.where(age >= 0.0, old, new), one_of(line, 0), newest)
        return _State(within=within, past=without_oldest(line)), told


@checked
def late(samples: int, episodes: Episodes, inner: Sensor | None = None) -> Late:
    """Sensor whose readings arrive late by whole samples during the episodes.

    A dead time that is always there is `dead_time`.

    Raises
    ------
    ValueError
        Unless `samples` is a whole number from 1 to 288.
    """
    if not 1 <= samples <= LONGEST:
        raise Refusal(f"a delay of {samples} samples is not possible; give a whole number from 1 to {LONGEST}")
    return Late(inner=or_ideal(inner), episodes=episodes, samples=samples)


def late_by(delay_min: float, episodes: Episodes, inner: Sensor | None = None, *, sample_time_min: float = 5.0) -> Late:
    """Sensor whose readings are late by some minutes, rounded up to samples; see `late`."""
    delay = delay_min / sample_time_min
    return late(math.ceil(delay - _HAIR) if math.isfinite(delay) else 0, episodes, inner)
