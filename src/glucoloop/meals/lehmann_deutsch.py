"""Gastric emptying and gut absorption of Lehmann and Deutsch (1992).

The stomach empties at a rate E(t) that rises along a ramp, stays on a plateau, and falls along a ramp. The gut holds
q mg and passes on the appearance ``r = q / T``, so that ``r' = (E - r) / T``. E is piecewise linear: a meal is the four
jumps of its slope E'.

References
----------
E. D. Lehmann, T. Deutsch, "A physiological model of glucose-insulin interaction in type 1 diabetes mellitus",
J. Biomed. Eng. 14, 1992.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.setting import About
from glucoloop.meals.models import MealModelComponent
from glucoloop.meals.protocol import Eaten, Jumps, matrix
from glucoloop.units import MG_PER_G


class LehmannDeutschSettings(MealModelComponent, name="lehmann-deutsch"):
    """A stomach that empties at most at a plateau rate, and a gut, of Lehmann and Deutsch (1992)."""

    sources = ("lehmann1992",)
    make: ClassVar = "glucoloop.meals:LehmannDeutsch"
    plateau_mg_min: Annotated[float, About("Largest rate of emptying.", above=0.0, at_most=1e5)] = 360.0
    ramp_min: Annotated[float, About("Length of each ramp of the rate.", above=0.0, at_most=1440.0)] = 30.0
    gut_time_constant_min: Annotated[float, About("Time constant of the gut.", above=0.0, at_most=1440.0)] = 60.0


PLATEAU_MG_MIN: Final = LehmannDeutschSettings.plateau_mg_min
RAMP_MIN: Final = LehmannDeutschSettings.ramp_min
GUT_TIME_CONSTANT_MIN: Final = LehmannDeutschSettings.gut_time_constant_min


@pytree
class LehmannDeutsch:
    """The meal model of Lehmann and Deutsch; states ``(r, E, E')``. Implements `MealModel`.

    A stomach that is never asked for more than it can give empties at most at its plateau rate and at most as fast as
    the meal is eaten. A meal of D mg eaten over d min therefore empties like the same meal eaten at once, unless d is
    longer than the D / plateau min for which that one empties; then the plateau is D / d, and the ramps begin when
    eating begins and when it ends.
    """

    plateau_mg_min: jax.Array | float = PLATEAU_MG_MIN
    """Largest rate of emptying."""
    ramp_min: jax.Array | float = RAMP_MIN
    """Length of each ramp."""
    gut_time_constant_min: jax.Array | float = GUT_TIME_CONSTANT_MIN
    """Time constant T of the gut."""

    def jumps(self, eaten: Eaten) -> Jumps:
        """Jumps of the slope E' [mg/min^2], ``4 * meals``.

        A meal that empties for less than the ramp's length has shorter ramps and no plateau, with the same peak.
        """
        dose_mg = jnp.asarray(eaten.carbs_g, float) * MG_PER_G
        at_once_min = dose_mg / self.plateau_mg_min
        slow = eaten.eating_min > at_once_min
        emptying_min = jnp.where(slow, eaten.eating_min, at_once_min)
        peak = jnp.where(slow, dose_mg / jnp.where(slow, eaten.eating_min, 1.0), self.plateau_mg_min)
        ramp = jnp.minimum(self.ramp_min, emptying_min)
        slope = jnp.where(dose_mg > 0.0, peak / jnp.where(ramp > 0.0, ramp, 1.0), 0.0)
        starts = jnp.stack([jnp.zeros_like(ramp), ramp, emptying_min, emptying_min + ramp])
        signs = jnp.asarray([1.0, -1.0, -1.0, 1.0]).reshape(4, *[1] * ramp.ndim)
        return Jumps(
            t_min=(jnp.asarray(eaten.t_min, float) + starts).reshape(-1, *ramp.shape[1:]),
            size=(signs * slope).reshape(1, -1, *ramp.shape[1:]),
        )

    def propagator(self, z_min: jax.Array) -> jax.Array:
        """Matrix exponential of emptying and gut, in closed form."""
        T = self.gut_time_constant_min
        rise = -jnp.expm1(-z_min / T)
        return matrix(
            (jnp.exp(-z_min / T), rise, z_min - T * rise),
            (0.0, 1.0, z_min),
            (0.0, 0.0, 1.0),
        )
