"""What all pump faults have in common: a pump inside, and times at which the fault is there."""

from __future__ import annotations

from typing import Any, Protocol

import jax

from glucoloop._pytree import pytree
from glucoloop.episodes import Episode, Episodes
from glucoloop.pumps.limited import LimitedPump
from glucoloop.pumps.protocol import Delivery, Pump, deliver


class Faulty(Protocol):
    """A pump with a fault."""

    @property
    def inner(self) -> Pump:
        """What it is a fault of."""
        ...

    @property
    def episodes(self) -> Episodes:
        """When it is there."""
        ...


@pytree
class Within:
    """State of the pump inside, and where the fault stands."""

    inner: Any
    episode: Episode


def begin(fault: Faulty, insulin_mU_min: jax.Array, key: jax.Array) -> Within:
    """Before the first command. The pump inside gets the key as it is, so that a fault does not disturb it."""
    return Within(inner=fault.inner.init(insulin_mU_min, key), episode=fault.episodes.init(insulin_mU_min, key))


def deliver_within(
    fault: Faulty, state: Within, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None
) -> tuple[Within, jax.Array, Delivery]:
    """Let the pump inside deliver; the age of the fault comes with it, -1 if there is none."""
    inner, delivery = deliver(fault.inner, state.inner, command_mU_min, key, bolus_mU)
    episode, age = fault.episodes.step(state.episode, key)
    return Within(inner=inner, episode=episode), age, delivery


def or_limited(inner: Pump | None) -> Pump:
    """A given pump, or one with the limits of the paper."""
    return LimitedPump() if inner is None else inner
