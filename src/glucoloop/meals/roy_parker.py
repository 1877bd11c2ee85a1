"""Gastric emptying and gut of Roy and Parker (2006), for the glucose of a meal.

The stomach empties N mg at a rate E that rises for T_asc, stays at ``V = 2 N / (T_asc + 2 T_max + T_des)`` for T_max,
and falls for T_des. The gut holds q mg and passes on ``k_G q``. That is the system of `LehmannDeutsch` with ramps and a
plateau whose lengths do not depend on the meal. Protein and fat, which the paper models too, are left out.

References
----------
A. Roy, R. S. Parker, "Mixed meal modeling and disturbance rejection in type I diabetic patients", Proc. 28th Annual
International Conference of the IEEE EMBS, 2006.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.setting import About
from glucoloop.meals.lehmann_deutsch import LehmannDeutsch
from glucoloop.meals.models import MealModelComponent
from glucoloop.meals.protocol import Eaten, Jumps
from glucoloop.units import MG_PER_G


class RoyParkerSettings(MealModelComponent, name="roy-parker"):
    """A stomach that empties for an hour whatever the meal, and a gut, of Roy and Parker (2006)."""

    sources = ("royparker2006",)
    make: ClassVar = "glucoloop.meals:RoyParkerGut"
    rise_min: Annotated[float, About("Time in which emptying rises.", at_least=1.0, at_most=1440.0)] = 10.0
    plateau_min: Annotated[float, About("Time for which it stays.", at_least=0.0, at_most=1440.0)] = 35.0
    fall_min: Annotated[float, About("Time in which it falls.", at_least=1.0, at_most=1440.0)] = 10.0
    absorption_per_min: Annotated[float, About("Rate constant of the gut, per minute.", above=0.0, at_most=1.0)] = 0.022


@pytree
class RoyParkerGut:
    """The meal model of Roy and Parker; states ``(k_G q, E, E')``. Implements `MealModel`.

    The paper's meals are eaten at once. One that is eaten for longer than the plateau has a plateau as long as eating.
    """

    rise_min: jax.Array | float = RoyParkerSettings.rise_min
    """T_asc: time in which emptying rises."""
    plateau_min: jax.Array | float = RoyParkerSettings.plateau_min
    """T_max: time for which it stays."""
    fall_min: jax.Array | float = RoyParkerSettings.fall_min
    """T_des: time in which it falls."""
    absorption_per_min: jax.Array | float = RoyParkerSettings.absorption_per_min
    """k_G: rate constant of the gut."""

    def jumps(self, eaten: Eaten) -> Jumps:
        """Jumps of the slope E' [mg/min^2], ``4 * meals``."""
        dose_mg = jnp.asarray(eaten.carbs_g, float) * MG_PER_G
        plateau = jnp.maximum(self.plateau_min, eaten.eating_min) + 0.0 * dose_mg
        rise, fall = (length + 0.0 * dose_mg for length in (self.rise_min, self.fall_min))
        peak = 2.0 * dose_mg / (rise + 2.0 * plateau + fall)
        starts = jnp.stack([0.0 * rise, rise, rise + plateau, rise + plateau + fall])
        slopes = jnp.stack([peak / rise, -peak / rise, -peak / fall, peak / fall])
        people = dose_mg.shape[1:]
        return Jumps(
            t_min=(jnp.asarray(eaten.t_min, float) + starts).reshape(-1, *people), size=slopes.reshape(1, -1, *people)
        )

    def propagator(self, z_min: jax.Array) -> jax.Array:
        """Matrix exponential of emptying and gut, in closed form."""
        return LehmannDeutsch(gut_time_constant_min=1.0 / self.absorption_per_min).propagator(z_min)
