"""Meals that were announced, and how much of them is still to be served."""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.meals.stomach import SERVED_G_PER_MIN

MEALS: Final = 4
"""Announced meals that can be under way at once; a further one is added to the one that ends first."""


@pytree
class Announced:
    """What is still to come of announced meals; people trailing."""

    remaining_min: jax.Array
    """(MEALS, ...) for how long each is still served."""


def nothing_announced(like: jax.Array) -> Announced:
    """No meal."""
    return Announced(remaining_min=jnp.zeros((MEALS, *jnp.shape(like))))


def announce(announced: Announced, carbs_g: jax.Array) -> Announced:
    """A meal begins; nothing that is not a positive finite amount is believed."""
    carbs = jnp.where((carbs_g > 0.0) & jnp.isfinite(carbs_g), carbs_g, 0.0)
    first = jnp.argmin(announced.remaining_min, axis=0)
    here = jnp.arange(MEALS).reshape(MEALS, *(1,) * jnp.ndim(first)) == first
    return Announced(remaining_min=announced.remaining_min + jnp.where(here, carbs / SERVED_G_PER_MIN, 0.0))


def serve(announced: Announced, sample_time_min: float) -> tuple[Announced, jax.Array]:
    """One sample: what remains, and the share of the sample in which there is something served, added over meals."""
    served_min = jnp.minimum(announced.remaining_min, sample_time_min)
    remaining = Announced(remaining_min=announced.remaining_min - served_min)
    return remaining, jnp.sum(served_min, axis=0) / sample_time_min
