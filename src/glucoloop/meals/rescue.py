"""Rescue carbohydrate: what a person eats against low glucose, in the loop, since it depends on the run.

By the rule of 15, a person with low glucose takes 15 g of fast carbohydrate, and the same again if glucose is still low
15 min later: American Diabetes Association, "Standards of care in diabetes", Diabetes Care 47 (Suppl. 1), 2024, Sec. 6.
It passes two compartments in a row with one time constant, as meals of Hovorka et al. (2004) do, but faster, and all of
it reaches the blood; a patient that digests in its own states eats it evenly until the next sample instead.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final, Literal

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.pytree_component import STATIC, PytreeComponent, wired
from glucoloop.component.setting import About
from glucoloop.meals.protocol import Ingestion, MealModel
from glucoloop.unit_guess import GLUCOSE_BOUND, MEAL
from glucoloop.units import MG_PER_G

_LONG_AGO_MIN = 1e5


@pytree
class _RescueState:
    """Time since the person last ate against low glucose, and what of it is still digested."""

    since_min: jax.Array
    compartments_mg_min: jax.Array
    """(2, ...) rates at which the second compartment empties into the blood, and the first into the second."""


class RescueComponent(PytreeComponent):
    """Carbohydrate that a person eats against low glucose: a component with the members of `RescueCarbs`."""

    kind: ClassVar = "rescue"


class RescueCarbs(RescueComponent, name="carbs"):
    """Fast carbohydrate at low glucose, and again while it stays low: the rule of 15.

    A time of 20 min to the largest appearance, half of that of a meal, is a choice here.

    Examples
    --------
    >>> import glucoloop as gl
    >>> gl.Scenario(rescue=gl.meals.rescue_carbs(65.0)).rescue.carbs_g
    15.0
    """

    sources = ("ada2024",)
    below_mg_dl: Annotated[
        float,
        About("Glucose below which the person eats, in mg/dl.", above=0.0, at_most=400.0, quantity=GLUCOSE_BOUND),
    ] = 70.0
    carbs_g: Annotated[float, About("Carbohydrate that is eaten.", above=0.0, at_most=1000.0, quantity=MEAL)] = 15.0
    again_min: Annotated[
        float, About("Time after which the person eats again if glucose is still low.", above=0.0, at_most=1440.0)
    ] = 15.0
    time_to_maximum_min: Annotated[
        float, About("Time from eating to the largest appearance.", above=0.0, at_most=1440.0)
    ] = 20.0
    by: Annotated[
        Literal["reading", "glucose"],
        About("Whether the person goes by the reading of the sensor, or by true glucose, as by symptoms or a meter."),
    ] = "reading"
    told: Annotated[bool, About("Whether the controller is told of it, at the next sample: true or false.")] = False
    digested_by_patient: bool = wired(STATIC, default=False)

    @property
    def by_reading(self) -> bool:
        """Whether the person goes by the reading of the sensor."""
        return self.by == "reading"

    def for_gut(self, gut: MealModel) -> RescueCarbs:
        """The same for a patient whose meals are absorbed by a model, or digested in the patient's own states."""
        return self.replaced(digested_by_patient=isinstance(gut, Ingestion))

    def init(self, like: jax.Array) -> _RescueState:
        """State of a person who has not eaten against low glucose for long."""
        zero = jnp.zeros_like(like)
        return _RescueState(since_min=zero + _LONG_AGO_MIN, compartments_mg_min=jnp.stack([zero, zero]))

    def eat(
        self, state: _RescueState, seen_mg_dl: jax.Array, moments: jax.Array, sample_time_min: float
    ) -> tuple[_RescueState, jax.Array, jax.Array]:
        """State after a sample, what is eaten at its beginning [g], and the moments of the appearance of all meals.

        `moments` ``(steps, 3, ...)`` are those of the other meals. What appears from rescue carbohydrate within a step
        is added evenly over the step, so that none of it is lost. Glucose that is not known, NaN, is not low.
        """
        eats = (seen_mg_dl < self.below_mg_dl) & (state.since_min >= self.again_min)
        eaten_g = jnp.where(eats, self.carbs_g, 0.0)
        eaten_mg = MG_PER_G * eaten_g
        steps = moments.shape[0]
        if self.digested_by_patient:
            blood, gut = state.compartments_mg_min
            means = [eaten_mg / sample_time_min] * steps
        else:
            tau, step_min = self.time_to_maximum_min, sample_time_min / steps
            decay = jnp.exp(-step_min / tau)
            blood, gut, means = state.compartments_mg_min[0], state.compartments_mg_min[1] + eaten_mg / tau, []
            for _ in range(steps):
                after = (blood + step_min / tau * gut) * decay, gut * decay
                means.append(tau / step_min * (blood + gut - after[0] - after[1]))
                blood, gut = after
        added = jnp.stack([jnp.stack([mean, 0.0 * mean, 0.0 * mean]) for mean in means])
        since = jnp.minimum(jnp.where(eats, 0.0, state.since_min) + sample_time_min, _LONG_AGO_MIN)
        return _RescueState(since_min=since, compartments_mg_min=jnp.stack([blood, gut])), eaten_g, moments + added


rescue_carbs: Final = RescueCarbs
RESCUES: Final = Catalogue(
    RescueComponent,
    {"carbs": "glucoloop.meals.rescue:RescueCarbs"},
    example="carbs, below_mg_dl=65",
    unnamed=True,
)
