"""Protocol of an estimator of unknown meals, its estimate, and the declaration of one."""

from __future__ import annotations

from typing import Any, ClassVar, Final, Protocol

from glucoloop._lazy_jax import jax
from glucoloop._pytree import pytree
from glucoloop.component.base import MadeComponent
from glucoloop.component.catalogue import Catalogue
from glucoloop.estimation.unknown_meal.habits import DailyRates
from glucoloop.meals.stomach import Announced, Stomach
from glucoloop.models.nonlinear import FedModel


@pytree
class MealEstimate:
    """Estimate of a person at a sample; expected values given the readings."""

    x: jax.Array
    """(n,) state of the model."""
    stomach: Stomach
    """Carbohydrate eaten, of announced and of other meals."""
    announced: Announced
    """Part of the announced meals that is still to be served."""
    disturbance_mg_min: jax.Array
    """Appearance of glucose that no meal explains; it may be negative."""
    eating: jax.Array
    """Probability that a meal that was not announced is being served, 0 to 1."""
    carbs_g: jax.Array
    """Size so far of the latest meal that was not announced; 0 before one is likely."""
    remaining_g: jax.Array
    """Carbohydrate of that meal that is likely still to come."""
    noise_mg_dl: jax.Array
    """Standard deviation of the correlated error of the sensor; 0 by an estimator that does not learn it."""
    gut_min: jax.Array
    """Time constant of the gut."""
    lost: jax.Array
    """Probability that insulin does not arrive, whatever the pump reports; 0 by an estimator that does not doubt it."""


@pytree
class Sensed:
    """Information that an estimator gets at a sample."""

    glucose_mg_dl: jax.Array
    known: jax.Array
    """Whether there is a valid reading."""
    insulin_mU_min: jax.Array
    """Rate that was delivered since the last sample."""
    reported: jax.Array
    """Whether the pump has reported that rate."""
    announced_carbs_g: jax.Array
    """Carbohydrate of an announced meal that begins during the coming sample."""
    time_of_day_min: jax.Array | None = None
    """Minutes after midnight at the reading, or None if they are not known or make no difference."""


class MealEstimator(Protocol):
    """Estimator from readings to meals. It is designed once; `step` never raises. The state is any pytree."""

    @property
    def daily(self) -> DailyRates | None:
        """Rates of meals by the time of day, None for an estimator on which the time makes no difference."""

    def at_each_rate(self) -> tuple[MealEstimator, ...]:
        """The same estimator at each of its rates of meals, held all day; itself alone where there is one."""

    def at_noise(self, deviation_mg_dl: float) -> MealEstimator:
        """The same estimator for a sensor whose correlated error has a known standard deviation."""

    def init(self, model: FedModel, sensed: Sensed) -> Any:
        """State before the first sample, of a person at steady state."""

    def step(self, model: FedModel, state: Any, sensed: Sensed) -> tuple[Any, MealEstimate]:
        """Carry the state to this sample and correct it by the reading."""


class EstimatorComponent(MadeComponent):
    """Declaration of an estimator of meals, an `estimation.unknown_meal.MealEstimator`.

    Its function is also given, if it has parameters of these names, what the controller assumes: ``model``
    (`models.nonlinear.FedModel`), ``habits`` (`estimation.unknown_meal.MealHabits`), ``disturbance_variance`` and
    ``measurement_variance``.
    """

    kind: ClassVar = "estimator"


ESTIMATORS: Final = Catalogue(
    EstimatorComponent,
    {
        "moving-horizon": "glucoloop.estimation.unknown_meal.moving_horizon:MovingHorizonSettings",
        "kalman": "glucoloop.estimation.unknown_meal.kalman:KalmanSettings",
    },
    example="moving-horizon, fast_meals=0",
    unnamed=True,
)
