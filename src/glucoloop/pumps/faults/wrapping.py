"""Common parts of all pump faults: an inner pump, and the episodes of the fault."""

from __future__ import annotations

from typing import Any, Protocol

import jax

from glucoloop._pytree import pytree
from glucoloop.episodes import Episode, Episodes
from glucoloop.pumps.limited import LimitedPump
from glucoloop.pumps.protocol import Delivery, Pump, deliver


class Faulty(Protocol):
    """Protocol of a pump with a fault."""

    @property
    def inner(self) -> Pump:
        """Pump that the fault acts on."""
        ...

    @property
    def episodes(self) -> Episodes:
        """Episodes during which the fault is present."""
        ...


@pytree
class Within:
    """State of the inner pump, and of the episodes of the fault."""

    inner: Any
    episode: Episode


def begin(fault: Faulty, insulin_mU_min: jax.Array, key: jax.Array) -> Within:
    """State before the first command.

    The inner pump gets the same key as without the fault, so its draws are the same.
    """
    return Within(inner=fault.inner.init(insulin_mU_min, key), episode=fault.episodes.init(insulin_mU_min, key))


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
