"""Gut absorption of Hovorka et al. (2004): two compartments in a row with one time constant.

With the eaten glucose ``D_1`` and ``D_2`` in the compartments and the bioavailability A_G,

    D_1' = A_G * (rate of eating) - D_1 / t_max,    D_2' = (D_1 - D_2) / t_max,    appearance = D_2 / t_max

so that a meal of D mg eaten at once appears as ``A_G D z exp(-z / t_max) / t_max^2`` z minutes later.

References
----------
R. Hovorka et al., "Nonlinear model predictive control of glucose concentration in subjects with type 1 diabetes",
Physiol. Meas. 25, 905-920, 2004.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.setting import About
from glucoloop.meals.models import MealModelComponent
from glucoloop.meals.protocol import Eaten, Jumps, matrix
from glucoloop.units import MG_PER_G


class HovorkaGutSettings(MealModelComponent, name="hovorka"):
    """Two compartments in a row with one time constant, of Hovorka et al. (2004)."""

    sources = ("hovorka2004",)
    make: ClassVar = "glucoloop.meals:HovorkaGut"
    time_to_maximum_min: Annotated[
        float, About("Time from eating at once to the largest appearance.", above=0.0, at_most=1440.0)
    ] = 40.0
    bioavailability: Annotated[
        float, About("Share of the eaten carbohydrate that reaches the blood.", above=0.0, at_most=1.0)
    ] = 0.8


TIME_TO_MAXIMUM_MIN: Final = HovorkaGutSettings.time_to_maximum_min
BIOAVAILABILITY: Final = HovorkaGutSettings.bioavailability


@pytree
class HovorkaGut:
    """The meal model of Hovorka et al.; states ``(D_2 / t_max, D_1 / t_max, A_G * rate of eating)``, all in mg/min.

    Implements `MealModel`. A meal eaten at once is a jump of D_1, and one that takes time two jumps of the rate of
    eating.
    """

    time_to_maximum_min: jax.Array | float = TIME_TO_MAXIMUM_MIN
    """t_max: time from eating at once to the largest appearance."""
    bioavailability: jax.Array | float = BIOAVAILABILITY
    """A_G: share of the eaten carbohydrate that reaches the blood."""

    def jumps(self, eaten: Eaten) -> Jumps:
        """Jumps of D_1 / t_max and of the rate of eating, ``2 * meals``."""
        dose_mg = self.bioavailability * jnp.asarray(eaten.carbs_g, float) * MG_PER_G
        takes_time = eaten.eating_min > 0.0
        none = jnp.zeros_like(dose_mg)
        rate = jnp.where(takes_time, dose_mg / jnp.where(takes_time, eaten.eating_min, 1.0), 0.0)
        at_once = jnp.where(takes_time, 0.0, dose_mg / self.time_to_maximum_min)
        begin = jnp.asarray(eaten.t_min, float) + none
        people = dose_mg.shape[1:]
        return Jumps(
            t_min=jnp.stack([begin, begin + eaten.eating_min]).reshape(-1, *people),
            size=jnp.stack([jnp.stack([at_once, none]), jnp.stack([rate, -rate])]).reshape(2, -1, *people),
        )

    def propagator(self, z_min: jax.Array) -> jax.Array:
        """Matrix exponential of the two compartments and the rate of eating, in closed form."""
        x = z_min / self.time_to_maximum_min
        decay, rise = jnp.exp(-x), -jnp.expm1(-x)
        return matrix(
            (decay, x * decay, rise - x * decay),
            (0.0, decay, rise),
            (0.0, 0.0, 1.0),
        )
