"""Pump without power."""

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
    """Delivers neither rate nor bolus and reports nothing; then the inner pump starts from rest at no insulin.

    All inner parts start again, faults and their planned times included: put other faults around this one.
    """

    inner: Pump
    episodes: Episodes

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Within:
        """State of the inner pump and of the fault before the first command."""
        return begin(self, insulin_mU_min, key)

    def deliver(
        self, state: Within, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[Within, Delivery]:
        """Deliver as the inner pump does, or nothing while the fault is present."""
        state, age, delivery = deliver_within(self, state, command_mU_min, key, bolus_mU)
        off = age >= 0.0
        at_rest = self.inner.init(jnp.zeros_like(delivery.insulin_mU_min), key)
        inner = jax.tree.map(lambda rest, running: jnp.where(off, rest, running), at_rest, state.inner)
        given, reported = (
            (delivery.insulin_mU_min, delivery.bolus_mU),
            (delivery.reported_mU_min, delivery.reported_bolus_mU),
        )
        insulin, bolus = jax.tree.map(lambda dose: jnp.where(off, 0.0, dose), given)
        told, told_bolus = jax.tree.map(lambda dose: jnp.where(off, jnp.nan, dose), reported)
        return Within(inner=inner, episode=state.episode), Delivery(
            insulin_mU_min=insulin, reported_mU_min=told, bolus_mU=bolus, reported_bolus_mU=told_bolus
        )


@checked
def battery_gap(episodes: Episodes, inner: Pump | None = None) -> BatteryGap:
    """Pump that has no power during the episodes."""
    return BatteryGap(inner=or_limited(inner), episodes=episodes)
