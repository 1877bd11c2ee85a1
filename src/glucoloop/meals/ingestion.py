"""Ingestion of meals by a patient model that includes digestion."""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.meals.protocol import Eaten, Jumps
from glucoloop.units import MG_PER_G

SHORTEST_EATING_MIN: Final = 1.0
"""Shortest time over which a meal is eaten, apart from a meal that is eaten at once."""


@pytree
class Ingestion:
    """The rate of eating itself, the only state [mg/min]; implements `MealModel`.

    Since a rate has to be finite, a meal takes at least one minute here, also one that is eaten at once.
    """

    def jumps(self, eaten: Eaten) -> Jumps:
        """Jumps of the rate of eating, ``2 * meals``."""
        dose_mg = jnp.asarray(eaten.carbs_g, float) * MG_PER_G
        eating_min = jnp.maximum(eaten.eating_min, SHORTEST_EATING_MIN)
        rate = dose_mg / eating_min
        begin = jnp.asarray(eaten.t_min, float) + jnp.zeros_like(rate)
        people = rate.shape[1:]
        return Jumps(
            t_min=jnp.stack([begin, begin + eating_min]).reshape(-1, *people),
            size=jnp.stack([rate, -rate]).reshape(1, -1, *people),
        )

    def propagator(self, z_min: jax.Array) -> jax.Array:
        """Matrix exponential of a rate that stays constant between jumps."""
        return jnp.ones((1, 1, *jnp.shape(z_min)))
