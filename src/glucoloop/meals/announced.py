"""Announced meals, and the part of them that is still to be served."""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.meals.stomach import SERVED_G_PER_MIN

MEALS: Final = 4
"""Largest number of announced meals under way at once; a further one is added to the one that ends first."""


@pytree
class Announced:
    """Remainder of the announced meals; people trailing."""

    remaining_min: jax.Array
    """(MEALS, ...) time for which each is still served."""


def nothing_announced(like: jax.Array) -> Announced:
    """State without any announced meal."""
    return Announced(remaining_min=jnp.zeros((MEALS, *jnp.shape(like))))


def announce(announced: Announced, carbs_g: jax.Array) -> Announced:
    """Begin a meal; an amount that is not positive and finite is ignored."""
    carbs = jnp.where((carbs_g > 0.0) & jnp.isfinite(carbs_g), carbs_g, 0.0)
    first = jnp.argmin(announced.remaining_min, axis=0)
    here = jnp.arange(MEALS).reshape(MEALS, *(1,) * jnp.ndim(first)) == first
    return Announced(remaining_min=announced.remaining_min + jnp.where(here, carbs / SERVED_G_PER_MIN, 0.0))


def serve(announced: Announced, sample_time_min: float) -> tuple[Announced, jax.Array]:
    """Advance by one sample: the remainder, and the served share of the sample, added over meals."""
    served_min = jnp.minimum(announced.remaining_min, sample_time_min)
    remaining = Announced(remaining_min=announced.remaining_min - served_min)
    return remaining, jnp.sum(served_min, axis=0) / sample_time_min
