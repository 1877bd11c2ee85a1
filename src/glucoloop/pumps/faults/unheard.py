"""A pump that does not hear what it is asked for."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.episodes import Episodes
from glucoloop.pumps.expiring import expiring
from glucoloop.pumps.faults.wrapping import Within, begin
from glucoloop.pumps.protocol import Delivery, Pump


@pytree
class Unheard:
    """Hands the pump inside a command that is not a number during the episodes."""

    inner: Pump
    episodes: Episodes

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Within:
        """See `Pump`."""
        return begin(self, insulin_mU_min, key)

    def deliver(self, state: Within, command_mU_min: jax.Array, key: jax.Array) -> tuple[Within, Delivery]:
        """Deliver what is inside, which hears the command or nothing."""
        episode, age = self.episodes.step(state.episode, key)
        heard = jnp.where(age >= 0.0, jnp.nan, command_mU_min)
        inner, delivery = self.inner.deliver(state.inner, heard, key)
        return Within(inner=inner, episode=episode), delivery


def unheard(episodes: Episodes, inner: Pump | None = None) -> Unheard:
    """Pump that hears nothing during the episodes.

    Parameters
    ----------
    episodes : Episodes
    inner : Pump, optional
        What delivers; by default a pump whose commands expire after two samples.
    """
    return Unheard(inner=expiring() if inner is None else inner, episodes=episodes)
