"""A pump that does not hear what it is asked for."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.episodes import Episodes
from glucoloop.pumps.expiring import expiring
from glucoloop.pumps.faults.wrapping import Within, begin
from glucoloop.pumps.protocol import Delivery, Pump, deliver


@pytree
class Unheard:
    """Hands the pump inside a rate and a bolus that are not numbers during the episodes: it gives no such bolus."""

    inner: Pump
    episodes: Episodes

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Within:
        """See `Pump`."""
        return begin(self, insulin_mU_min, key)

    def deliver(
        self, state: Within, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[Within, Delivery]:
        """Deliver what is inside, which hears the command or nothing."""
        episode, age = self.episodes.step(state.episode, key)
        there = age >= 0.0
        heard = jnp.where(there, jnp.nan, command_mU_min)
        bolus = None if bolus_mU is None else jnp.where(there, jnp.nan, bolus_mU)
        inner, delivery = deliver(self.inner, state.inner, heard, key, bolus)
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
