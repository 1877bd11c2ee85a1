"""Pump that does not receive its commands."""

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
    """Gives the inner pump NaN as rate and bolus during the episodes, so that it gives no bolus."""

    inner: Pump
    episodes: Episodes

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Within:
        """State of the inner pump and of the fault before the first command."""
        return begin(self, insulin_mU_min, key)

    def deliver(
        self, state: Within, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[Within, Delivery]:
        """Deliver as the inner pump does, with the command or with none."""
        episode, age = self.episodes.step(state.episode, key)
        there = age >= 0.0
        heard = jnp.where(there, jnp.nan, command_mU_min)
        bolus = None if bolus_mU is None else jnp.where(there, jnp.nan, bolus_mU)
        inner, delivery = deliver(self.inner, state.inner, heard, key, bolus)
        return Within(inner=inner, episode=episode), delivery


def unheard(episodes: Episodes, inner: Pump | None = None) -> Unheard:
    """Pump that receives no commands during the episodes.

    Parameters
    ----------
    episodes : Episodes
    inner : Pump, optional
        Inner pump; by default one whose commands expire after two samples.
    """
    return Unheard(inner=expiring() if inner is None else inner, episodes=episodes)
