"""Limits of a pump: the constraints (17) and (18) of Parker, Doyle and Peppas (1999)."""

from __future__ import annotations

import math
from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import checked, is_traced
from glucoloop.parts.routes import PUMP_OF_1999
from glucoloop.refusal import Refusal


@pytree
class DoseLimits:
    """Bounds on the infusion and on its change from one sample to the next."""

    max_change_mU_min: jax.Array | float = PUMP_OF_1999.max_change_mU_min
    min_mU_min: jax.Array | float = PUMP_OF_1999.min_mU_min
    max_mU_min: jax.Array | float = PUMP_OF_1999.max_mU_min

    def clip(self, insulin_mU_min: jax.Array, previous_mU_min: jax.Array) -> jax.Array:
        """Clip the change first and the magnitude second, as the paper does."""
        change = jnp.clip(insulin_mU_min - previous_mU_min, -self.max_change_mU_min, self.max_change_mU_min)
        return jnp.clip(previous_mU_min + change, self.min_mU_min, self.max_mU_min)

    def allow(self, insulin_mU_min: jax.Array, previous_mU_min: jax.Array, slack_mU_min: float = 0.0) -> jax.Array:
        """Whether a rate keeps both limits, compared with the limits themselves, since a clipped rate is rounded."""
        change = jnp.abs(insulin_mU_min - previous_mU_min)
        return (
            (change <= self.max_change_mU_min + slack_mU_min)
            & (insulin_mU_min >= self.min_mU_min - slack_mU_min)
            & (insulin_mU_min <= self.max_mU_min + slack_mU_min)
        )


PARKER_1999_LIMITS: Final = DoseLimits()
"""Limits of the paper."""


@checked
def dose_limits(
    *,
    max_change_mU_min: float = PUMP_OF_1999.max_change_mU_min,
    min_mU_min: float = PUMP_OF_1999.min_mU_min,
    max_mU_min: float = PUMP_OF_1999.max_mU_min,
) -> DoseLimits:
    """Limits with the given bounds; those of Parker et al. (1999) for the others.

    Raises
    ------
    ValueError
        Unless ``0 < max_change`` and ``0 <= min < max``, all finite.
    """
    if not is_traced(max_change_mU_min) and not 0.0 < max_change_mU_min < math.inf:
        raise Refusal(
            f"a rate limit of {max_change_mU_min:g} mU/min per sample is not possible; give a finite value above 0"
        )
    if not is_traced(min_mU_min, max_mU_min) and not 0.0 <= min_mU_min < max_mU_min < math.inf:
        raise Refusal(
            f"a dose range of {min_mU_min:g} to {max_mU_min:g} mU/min is not possible; "
            "give 0 or more as the lower and a larger finite value as the upper bound"
        )
    return DoseLimits(max_change_mU_min=max_change_mU_min, min_mU_min=min_mU_min, max_mU_min=max_mU_min)
