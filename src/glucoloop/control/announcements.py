"""Announced meals that are still to be eaten, for controllers that model what is eaten.

A person may announce a meal before eating and tell when it will be eaten, so that insulin given at the announcement has
begun to act by then. Therapies dose at the announcement; a model begins the meal when it is eaten.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.control.protocol import Observation
from glucoloop.limits import LONGEST_AHEAD_MIN

MEALS: Final = 4
"""Announced meals that can be awaited at once; of a further one the oldest is taken to begin."""
_MAX_CARBS_G: Final = 1000.0
"""Largest carbohydrate of a meal that is accepted."""


@pytree
class MealsToCome:
    """Announced meals ``(meals, ...)`` that are still to be eaten, the newest first; a meal of 0 g is none."""

    carbs_g: jax.Array
    in_min: jax.Array
    """Time from the coming sample until each is eaten."""


def no_meals_to_come(observation: Observation) -> MealsToCome | None:
    """Empty memory of meals, or None where observations tell no time of eating."""
    if observation.announced_in_min is None:
        return None
    none = jnp.stack([jnp.zeros_like(observation.announced_carbs_g)] * MEALS)
    return MealsToCome(carbs_g=none, in_min=none)


def eaten_in_min(observation: Observation) -> jax.Array:
    """Time until the announced meal is eaten; 0 where no time or an impossible one is told."""
    ahead_min = observation.announced_in_min
    if ahead_min is None:
        return jnp.zeros_like(observation.announced_carbs_g)
    return jnp.where((ahead_min >= 0.0) & (ahead_min <= LONGEST_AHEAD_MIN), ahead_min, 0.0)


def hear(
    to_come: MealsToCome | None, observation: Observation, carbs_g: jax.Array, sample_time_min: float
) -> tuple[MealsToCome | None, jax.Array]:
    """Meals that are still to be eaten after an announcement, and the carbohydrate that begins in the coming sample.

    `to_come` is what this function returned a sample before; where it is None, what is announced begins at once.
    """
    if to_come is None:
        return None, carbs_g
    awaited = jnp.where((to_come.carbs_g > 0.0) & (to_come.carbs_g <= _MAX_CARBS_G), to_come.carbs_g, 0.0)
    left_min = jnp.where(to_come.in_min <= LONGEST_AHEAD_MIN, to_come.in_min - sample_time_min, 0.0)
    carbs = jnp.concatenate([carbs_g[None], awaited])
    in_min = jnp.concatenate([eaten_in_min(observation)[None], left_min])
    waits = (carbs > 0.0) & (in_min >= sample_time_min)
    begins = jnp.sum(jnp.where(waits, 0.0, carbs), axis=0)
    carbs, in_min = jnp.where(waits, carbs, 0.0), jnp.where(waits, in_min, 0.0)
    new = waits[0]
    begins = begins + jnp.where(new, carbs[-1], 0.0)
    return MealsToCome(
        carbs_g=jnp.where(new, carbs[:-1], carbs[1:]), in_min=jnp.where(new, in_min[:-1], in_min[1:])
    ), begins
