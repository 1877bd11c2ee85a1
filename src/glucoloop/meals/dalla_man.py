"""Gut of Dalla Man, Camilleri and Cobelli (2006), whose stomach empties at a rate that depends on the whole meal.

With the glucose q_sto1, solid, and q_sto2, triturated, in the stomach and q_gut in the gut [mg],

    q_sto1' = -k_max q_sto1 + (rate of eating)
    q_sto2' =  k_max q_sto1 - k_empt q_sto2
    q_gut'  =  k_empt q_sto2 - k_abs q_gut,              appearance = f k_abs q_gut

    k_empt = k_min + (k_max - k_min) / 2 * { tanh[alpha (q_sto - b D)] - tanh[beta (q_sto - d D)] + 2 }
    alpha = 5 / (2 D (1 - b)),    beta = 5 / (2 D d),    q_sto = q_sto1 + q_sto2

so that the stomach empties fast when it is full, slowly when it holds a share b of the meal D, and fast again when it
holds a share d. D is what was in the stomach when the last meal began, and what has been eaten since: with it the gut
remembers the meal, and meals do not superpose. Food is triturated at the rate k_max, as the simulator of 2008 has it.

References
----------
C. Dalla Man, M. Camilleri, C. Cobelli, "A system model of oral glucose absorption: validation on gold standard data",
IEEE Trans. Biomed. Eng. 53(12), 2006, 2472-2478.
C. Dalla Man, R. A. Rizza, C. Cobelli, "Meal simulation model of the glucose-insulin system", IEEE Trans. Biomed. Eng.
54(10), 2007, 1740-1749, Table I (normal subject).
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.setting import About
from glucoloop.meals.models import MealModelComponent


class DallaManGutSettings(MealModelComponent, name="dalla-man"):
    """A stomach that empties by how much of the whole meal it holds, of Dalla Man et al. (2006)."""

    sources = ("dallaman2006", "dallaman2007")
    make: ClassVar = "glucoloop.meals:DallaManGut"
    k_max: Annotated[
        float, About("Largest rate of emptying, and rate of trituration, per minute.", above=0.0, at_most=1.0)
    ] = 0.0558
    k_min: Annotated[float, About("Smallest rate of emptying, per minute.", above=0.0, at_most=1.0)] = 0.0080
    k_abs: Annotated[float, About("Rate of absorption from the gut, per minute.", above=0.0, at_most=1.0)] = 0.057
    b: Annotated[
        float, About("Share of the meal in the stomach at which emptying is slower by half.", above=0.0, at_most=0.99)
    ] = 0.82
    d: Annotated[
        float, About("Share of the meal in the stomach at which emptying is faster by half.", above=0.001, at_most=0.99)
    ] = 0.010
    bioavailability: Annotated[
        float, About("Share of the absorbed carbohydrate that reaches the blood.", above=0.0, at_most=1.0)
    ] = 0.90


@pytree
class DallaManGut:
    """The gut of Dalla Man et al.; states ``(q_sto1, q_sto2, q_gut, D)`` in mg. Implements `OdeMealModel`."""

    k_max: jax.Array | float = DallaManGutSettings.k_max
    """Largest rate of emptying, and rate of trituration, per minute."""
    k_min: jax.Array | float = DallaManGutSettings.k_min
    """Smallest rate of emptying, per minute."""
    k_abs: jax.Array | float = DallaManGutSettings.k_abs
    """Rate of absorption from the gut, per minute."""
    b: jax.Array | float = DallaManGutSettings.b
    """Share of the meal in the stomach at which emptying has slowed down by half."""
    d: jax.Array | float = DallaManGutSettings.d
    """Share of the meal in the stomach at which emptying has become faster by half."""
    bioavailability: jax.Array | float = DallaManGutSettings.bioavailability
    """f: share of the absorbed glucose that appears in the blood."""

    def init(self) -> jax.Array:
        """Empty stomach and gut, and no meal to remember."""
        people = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves(self)))
        return jnp.zeros((4, *people))

    def at_point(self, state: jax.Array, eaten_mg: jax.Array, begins: jax.Array) -> jax.Array:
        """State with the meal D that counts from here on."""
        q_sto1, q_sto2, q_gut, D = state
        return jnp.stack([q_sto1, q_sto2, q_gut, jnp.where(begins, q_sto1 + q_sto2, D) + eaten_mg])

    def derivative(self, state: jax.Array, eating_mg_min: jax.Array) -> jax.Array:
        """Balances of stomach and gut."""
        q_sto1, _, q_gut, _ = state
        ground, emptied = self.k_max * q_sto1, self.emptying_mg_min(state)
        return jnp.stack(
            [eating_mg_min - ground, ground - emptied, emptied - self.k_abs * q_gut, jnp.zeros_like(q_gut)]
        )

    def emptying_mg_min(self, state: jax.Array) -> jax.Array:
        """Rate at which the stomach empties, k_empt q_sto2."""
        q_sto1, q_sto2, _, D = state
        # before the first meal both tangents are of zero, which makes k_empt = k_max
        per_meal = jnp.where(D > 0.0, 2.5 / jnp.where(D > 0.0, D, 1.0), 0.0)
        q_sto = q_sto1 + q_sto2
        slows = jnp.tanh(per_meal * (1.0 / (1.0 - self.b)) * (q_sto - self.b * D))
        hastens = jnp.tanh(per_meal * (1.0 / self.d) * (q_sto - self.d * D))
        empties: jax.Array = (self.k_max + (self.k_max - self.k_min) / 2.0 * (slows - hastens)) * q_sto2
        return empties

    def appearance_mg_min(self, state: jax.Array) -> jax.Array:
        """Rate of appearance, f k_abs q_gut."""
        appears: jax.Array = self.bioavailability * self.k_abs * state[2]
        return appears
