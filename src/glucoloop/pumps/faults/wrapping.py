"""Common parts of all pump faults: an inner pump, and the episodes of the fault."""

from __future__ import annotations

import jax

from glucoloop.episodes import Faulty, Within, begin
from glucoloop.pumps.limited import LimitedPump
from glucoloop.pumps.protocol import Delivery, Pump, deliver

__all__ = ["Within", "begin", "deliver_within", "or_limited"]


def deliver_within(
    fault: Faulty, state: Within, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None
) -> tuple[Within, jax.Array, Delivery]:
    """Let the inner pump deliver; the age of the fault comes with the result, -1 while the fault is absent."""
    inner, delivery = deliver(fault.inner, state.inner, command_mU_min, key, bolus_mU)
    episode, age = fault.episodes.step(state.episode, key)
    return Within(inner=inner, episode=episode), age, delivery


def or_limited(inner: Pump | None) -> Pump:
    """The given pump, or one with the limits of the paper for None."""
    return LimitedPump() if inner is None else inner
