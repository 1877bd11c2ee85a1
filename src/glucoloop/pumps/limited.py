"""A pump that keeps its dose limits, whatever it is told."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.pumps.protocol import Delivery


@pytree
class LimitedPump:
    """Clips rate of change and magnitude. A command that is not a number moves toward the least dose."""

    limits: DoseLimits = PARKER_1999_LIMITS

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> jax.Array:
        """The last delivered rate."""
        del key
        return jnp.clip(insulin_mU_min, self.limits.min_mU_min, self.limits.max_mU_min)

    def deliver(self, state: jax.Array, command_mU_min: jax.Array, key: jax.Array) -> tuple[jax.Array, Delivery]:
        """Deliver the nearest allowed rate."""
        del key
        command = jnp.where(jnp.isnan(command_mU_min), self.limits.min_mU_min, command_mU_min)
        delivered = self.limits.clip(command, state)
        return delivered, Delivery(insulin_mU_min=delivered, reported_mU_min=delivered)
