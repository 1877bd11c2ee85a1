"""Pump that keeps its dose limits for any command."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.pumps.bolus import USUAL_BOLUS_LIMITS, BolusLimits
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.pumps.protocol import Delivery


@pytree
class LimitedPump:
    """Clips rate of change and magnitude of the basal rate, and keeps the limits of a bolus.

    A commanded rate that is not a number moves toward the least rate. A bolus does not count as a change of the rate.
    """

    limits: DoseLimits = PARKER_1999_LIMITS
    bolus: BolusLimits = USUAL_BOLUS_LIMITS

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> jax.Array:
        """State of the pump: the last delivered rate."""
        return jnp.clip(insulin_mU_min, self.limits.min_mU_min, self.limits.max_mU_min)

    def deliver(
        self, state: jax.Array, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[jax.Array, Delivery]:
        """Deliver the nearest allowed rate, and the bolus as far as it is allowed."""
        command = jnp.where(jnp.isnan(command_mU_min), self.limits.min_mU_min, command_mU_min)
        delivered = self.limits.clip(command, state)
        bolus = None if bolus_mU is None else self.bolus.allowed(bolus_mU)
        return delivered, Delivery(
            insulin_mU_min=delivered, reported_mU_min=delivered, bolus_mU=bolus, reported_bolus_mU=bolus
        )
