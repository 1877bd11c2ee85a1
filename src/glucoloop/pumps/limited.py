"""A pump that keeps its dose limits, whatever it is told."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits


@pytree
class LimitedPump:
    """Clips rate of change and magnitude. A command that is not a number moves toward the least dose."""

    limits: DoseLimits = PARKER_1999_LIMITS

    def init(self, insulin_mU_min: jax.Array) -> jax.Array:
        """The last delivered rate."""
        return jnp.clip(insulin_mU_min, self.limits.min_mU_min, self.limits.max_mU_min)

    def deliver(self, state: jax.Array, command_mU_min: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Deliver the nearest allowed rate."""
        command = jnp.where(jnp.isnan(command_mU_min), self.limits.min_mU_min, command_mU_min)
        delivered = self.limits.clip(command, state)
        return delivered, delivered
