"""A pump without power."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked
from glucoloop.episodes import Episodes
from glucoloop.pumps.faults.wrapping import Within, begin, deliver_within, or_limited
from glucoloop.pumps.protocol import Delivery, Pump


@pytree
class BatteryGap:
    """Delivers nothing and reports nothing; when it is over, the pump inside starts from rest at no insulin.

    All that is inside starts anew, faults and their planned times included: put other faults around this one.
    """

    inner: Pump
    episodes: Episodes

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Within:
        """See `Pump`."""
        return begin(self, insulin_mU_min, key)

    def deliver(self, state: Within, command_mU_min: jax.Array, key: jax.Array) -> tuple[Within, Delivery]:
        """Deliver what is inside, or nothing while the fault is there."""
        state, age, delivery = deliver_within(self, state, command_mU_min, key)
        off = age >= 0.0
        at_rest = self.inner.init(jnp.zeros_like(delivery.insulin_mU_min), key)
        inner = jax.tree.map(lambda rest, running: jnp.where(off, rest, running), at_rest, state.inner)
        return Within(inner=inner, episode=state.episode), Delivery(
            insulin_mU_min=jnp.where(off, 0.0, delivery.insulin_mU_min),
            reported_mU_min=jnp.where(off, jnp.nan, delivery.reported_mU_min),
        )


@checked
def battery_gap(episodes: Episodes, inner: Pump | None = None) -> BatteryGap:
    """Pump that has no power during the episodes."""
    return BatteryGap(inner=or_limited(inner), episodes=episodes)
