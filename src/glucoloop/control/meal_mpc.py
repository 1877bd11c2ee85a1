"""Nonlinear model predictive control with estimation and forecast of meals that are not announced.

The meal is that of Lehmann and Deutsch (1992), estimated as in `estimation.unknown_meal`. One quadratic program at each
sample, linearised along a forecast, is the real-time iteration of M. Diehl, H. G. Bock, J. P. Schloeder, SIAM J.
Control Optim. 43(5), 2005.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.arguments import checked, on_host
from glucoloop.component.effects import TIME_OF_DAY, Need
from glucoloop.component.pytree_component import DATA, STATIC, wired
from glucoloop.component.request import by_default
from glucoloop.component.setting import About, Tuned
from glucoloop.control.decision import (
    MealsToCome,
    decide,
    delivered_since,
    hear,
    is_known,
    is_of_a_person,
    no_meals_to_come,
    rate_at_start,
)
from glucoloop.control.design_case import DesignCase
from glucoloop.control.horizon import response_at_rest, suited
from glucoloop.control.meal_forecast import Ahead, MealForecast
from glucoloop.control.part import CAUTION, SensorLag
from glucoloop.control.protocol import Decision, DoseForecast, Observation
from glucoloop.control.tuning import MealTuning
from glucoloop.estimation.unknown_meal import (
    ESTIMATORS,
    EstimatorComponent,
    MealEstimate,
    MealEstimator,
    MealHabits,
    Sensed,
)
from glucoloop.estimation.unknown_meal.expectation import Expectation, expectation
from glucoloop.estimation.unknown_meal.habits import earlier
from glucoloop.models.nonlinear import (
    FedModel,
    IndividualModel,
    individual_model,
)
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.qp.moves_qp import limit_moves
from glucoloop.qp.soft_floor import minimise_moves_above_floor
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import MEAL

_MIN_VARIANCE: Final = 0.01
"""(mg/dl)^2 that a filter expects of readings without noise."""
_MAX_VARIANCE: Final = 1.45
"""(mg/dl)^2 of white noise of the sensor that a filter expects at most where it learns the rest.

A correlated error that is taken for white noise looks like a meal.
"""
_CAUTIOUS_VARIANCE: Final = 5.0
"""(mg/dl)^2 of noise at which half of `caution_mg_dl` is left."""
_LASTING_DOUBT: Final = 0.1
"""Added to the variance P (1 - P) of whether there is a meal: also of a certain one the end and the speed are not."""
_LASTS_MIN: Final = 120.0
"""Time at steady state, in min, after which most of a steady unexplained appearance counts as lasting."""
_LARGEST_LASTING_MG_MIN: Final = 100.0
_AT_REST_MG_DL: Final = 5.0
"""Distance from the setpoint, in mg/dl, at which a lasting appearance is learned at half its pace."""
_AT_REST_MG: Final = 1000.0
"""Content of the gut, in mg, at which it is learned at half its pace."""


_STEADY: Final = Need("meals_by_time takes its place")


@pytree
class _MealMPCState:
    """State of the controller."""

    estimator: Any
    delivered_mU_min: jax.Array
    """(dead time + 1,) rates of the last samples, the latest last."""
    reported: jax.Array
    """(dead time,) whether the pump reported the rates of the last samples, the latest last."""
    announced_g: jax.Array
    """(dead time,) announced carbohydrate of the last samples, the latest last."""
    planned: jax.Array
    """(m,) moves planned for the coming sample and those after it, along which the model is linearised."""
    lasting_mg_min: jax.Array
    """Unexplained appearance at steady state, such as a wrong basal rate leaves, from 0: it does not stop at once."""
    to_come: MealsToCome | None = None
    """Announced meals that are still to be eaten; None where observations tell no time of eating."""


class _Planned(NamedTuple):
    """Estimate at a sample, and the plan."""

    state: _MealMPCState
    """State after the sample."""
    estimate: MealEstimate
    """Estimate of the time of the reading."""
    sound: jax.Array
    """Whether the estimate can be that of a person."""
    known: jax.Array
    delivered_mU_min: jax.Array
    now: Ahead
    """Expected state at the sample, from which glucose is forecast."""
    lasting_mg_min: jax.Array
    variance: jax.Array
    """Variance of the readings that the forecasts assume."""
    moves: jax.Array
    converged: jax.Array


class MealMPC(MealTuning, name="meal-mpc"):
    """Predictive control on the nonlinear patient that estimates meals nobody announced.

    At each sample an estimator gives the state of the person, the probability that a meal is being served, and the
    content of stomach and gut. From there the nonlinear model predicts glucose twice: its expected value, where a meal
    under way ends with its usual probability, and its value if that meal ended at this moment, and with it the share
    `doubt` of the glucose that no meal explains and a share of what is in stomach and gut. That share is `gut_doubt`
    V / (V + 3), where V is the variance in (mg/dl)^2 of the readings' noise, which hides how fast they empty. The moves
    solve::

        min over du of  Gamma_y^2 |r - G|^2 + Gamma_u^2 |du|^2
                        + w^2 (P (1 - P) + 0.1) |max(0, r - 5 c / (V + 5) - G_end)|^2
                        + w_f^2 |max(0, floor - G_end)|^2

    subject to the pump's rate and magnitude limits at every planned move; G and G_end are linearised along the plan.
    An announced meal is served in both forecasts. A known dead time is bridged by predicting from the moment that the
    reading speaks of, under the rates that were delivered since. A lasting error of the model is estimated as an
    appearance of glucose and goes on in the forecast. What of it stays for hours at steady state is learned and no
    longer doubted, so that no offset is left but what `anticipation` asks for, as long as the error is within what the
    estimator believes: a basal rate that is far too small is taken for insulin that does not arrive.

    ============  ===========================================================  ======
    variable      meaning                                                      size
    ============  ===========================================================  ======
    ``G``         glucose expected at the samples ahead                        (p,)
    ``G_end``     the same if what is uncertain of it ended now                (p,)
    ``P``         probability that a meal nobody announced is being served     ()
    ``du``        planned moves                                                (m,)
    ============  ===========================================================  ======
    """

    sources = ("lehmann1992", "diehl2005")
    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.build.individual:individual_meal_mpc"
    slow: ClassVar = True
    heals: ClassVar[bool] = True
    """Whether a step leaves a finite state after any state, so that a guard need not check it."""
    searched: ClassVar = (
        Tuned("move_weight", 0.02, 2.0, log=True),
        Tuned("caution_weight", 0.5, 50.0, log=True),
        Tuned("caution_mg_dl", 0.0, 15.0, log=False),
        Tuned("meals_per_h", 0.02, 5.0, log=True),
        Tuned("mean_carbs_g", 10.0, 150.0, log=True),
        Tuned("disturbance_variance", 0.1, 1000.0, log=True),
        Tuned("output_weight", 0.1, 10.0, log=True, by_default=False),
        Tuned("glucose_floor_mg_dl", 55.0, 80.0, log=False, by_default=False),
        Tuned("floor_weight", 0.5, 50.0, log=True, by_default=False),
        Tuned("measurement_variance", 0.3, 30.0, log=True, by_default=False),
    )

    estimator: Annotated[EstimatorComponent, About("Estimator of meals.")] = by_default(ESTIMATORS[ESTIMATORS.default])
    meals_per_h: Annotated[
        float,
        About("Expected number of meals per hour; more is quicker and less certain.", above=0.0, needs=(_STEADY,)),
    ] = 0.57
    meals_by_time: Annotated[
        str,
        About(
            "Expected number of meals per hour by the time of day, in place of meals_per_h: values with the times from "
            "which they hold, like '0.6@06:30 0.02@22:00', or 24 numbers, one for each hour; empty: always the same."
        ),
    ] = ""
    mean_carbs_g: Annotated[float, About("Mean size of a meal, in g.", above=0.0, quantity=MEAL)] = 20.0
    disturbance_variance: Annotated[
        float, About("Variance of the change of unexplained glucose per sample, (mg/min)².", at_least=0.0)
    ] = 10.0
    measurement_variance: Annotated[
        float,
        About(
            "Variance of a reading that the filter assumes, R; 0: that of the sensor, from 0.01 to 1.45 where the "
            "estimator learns the noise beyond it.",
            at_least=0.0,
        ),
    ] = 0.0
    sensor_lag_min: SensorLag = 0.0
    individual_by: Annotated[
        Literal["record", "basal", "none"],
        About("Source of gain and lag of insulin in a design for each person, beside the basal rate."),
    ] = "record"

    _: KW_ONLY
    model: IndividualModel = wired(DATA, default=None)
    meal_estimator: MealEstimator = wired(DATA, default=None)
    """The estimator of meals, made for the model."""
    expected: Expectation = wired(DATA, default=None)
    """Expectation of the estimator about meals at steady state."""
    ends: jax.Array = wired(DATA, default=None)
    """Probability that a meal under way ends in a sample."""
    R: jax.Array | float = wired(DATA, default=None)
    """Variance of a reading that the forecasts assume."""
    limits: DoseLimits = wired(DATA, default=PARKER_1999_LIMITS)
    moves: int = wired(STATIC, default=0)
    """Number of planned moves."""
    horizon: int = wired(STATIC, default=0)
    """Number of predicted samples."""
    dead_time_samples: int = wired(STATIC, default=0)
    sample_time_min: float = wired(STATIC, default=5.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.needs_time_of_day:
            self.habits()

    def uses(self) -> frozenset[Need]:
        """Needs that the controller meets; the time of day where meals are expected by it."""
        cautious = frozenset({CAUTION} if self.caution_weight else ())
        return super().uses() | cautious | frozenset({TIME_OF_DAY} if self.needs_time_of_day else {_STEADY})

    @property
    def needs_time_of_day(self) -> bool:
        """Whether decisions depend on the time of day; without it meals are expected at the rate `meals_per_h`."""
        return bool(self.meals_by_time) if self.meal_estimator is None else self.meal_estimator.daily is not None

    def habits(self) -> MealHabits:
        """Prior of meals; meals by the time of day that are no table are refused."""
        return MealHabits(self.meals_per_h, self.mean_carbs_g, self.meals_by_time)

    def designed(self, case: DesignCase) -> MealMPC:
        """Meal-aware nonlinear MPC, on the equations of the patient."""
        case = case.behind_lag(self.sensor_lag_min)
        variance = self.measurement_variance or _measurement_variance(case.noise_variance, self.estimator)
        return self.of_model(case.nonlinear(), case.limits, variance, dead_time_samples=case.dead_time_samples)

    def of_model(
        self,
        model: FedModel,
        limits: DoseLimits,
        measurement_variance: float,
        *,
        habits: MealHabits | None = None,
        dead_time_samples: int = 0,
        min_horizon: int = 1,
    ) -> MealMPC:
        """The controller on a model, for readings of a variance; see `design_meal_mpc`.

        A horizon of 0 becomes one that suits the model and is not shorter than `min_horizon`.
        """
        habits = self.habits() if habits is None else habits
        if dead_time_samples < 0:
            raise Refusal(
                f"a dead time of {dead_time_samples} samples is not possible; give a whole number of 0 or more"
            )
        tuning = suited(self, *response_at_rest(model), usual=min_horizon)
        individual = individual_model(model, model.insulin_mU_min)
        meal_estimator: MealEstimator = self.estimator.made(
            model=individual,
            habits=habits,
            disturbance_variance=self.disturbance_variance,
            measurement_variance=measurement_variance,
        )
        controller: MealMPC = tuning.made(
            model=individual,
            meal_estimator=meal_estimator,
            expected=expectation(meal_estimator, individual),
            ends=jnp.asarray(habits.ends(model.sample_time_min)),
            R=measurement_variance,
            limits=limits,
            moves=tuning.move_horizon,
            horizon=tuning.prediction_horizon,
            dead_time_samples=dead_time_samples,
            sample_time_min=model.sample_time_min,
        )
        return controller

    def with_basal(self, insulin_mU_min: jax.Array) -> MealMPC:
        """The same controller for a person with the given basal rate.

        A person who needs little insulin is likely to respond strongly to it: over the people of `parker2000` the gain
        is about inversely proportional to the square root of the basal rate, and so it is taken.
        """
        scale = jnp.sqrt(self.model.nominal.insulin_mU_min / insulin_mU_min)
        return self.for_person(insulin_mU_min, scale)

    def for_person(
        self, insulin_mU_min: jax.typing.ArrayLike, gain: jax.typing.ArrayLike = 1.0, lag: jax.typing.ArrayLike = 1.0
    ) -> MealMPC:
        """The same controller for another person: a basal rate, and gain and lag of insulin relative to the model's."""
        numbers = (jnp.asarray(number, float) for number in (insulin_mU_min, gain, lag))
        insulin, gain, lag = jnp.broadcast_arrays(*numbers)
        return self.replaced(model=individual_model(self.model.nominal, insulin, gain, lag))

    def settled(self) -> dict[str, Any]:
        """Horizons, in samples; a known dead time is within them."""
        return {"move_horizon": self.moves, "prediction_horizon": self.horizon}

    def init(self, observation: Observation) -> _MealMPCState:
        """Steady state under the delivered rate; unexplained glucose counts as a disturbance."""
        known, delivered = is_known(observation), rate_at_start(observation, self.model.insulin_mU_min)
        delivered = jnp.clip(delivered, self.limits.min_mU_min, self.limits.max_mU_min)
        sensed = Sensed(
            glucose_mg_dl=jnp.where(known, observation.glucose_mg_dl, 0.0),
            known=known,
            insulin_mU_min=delivered,
            reported=jnp.asarray(True),
            announced_carbs_g=jnp.zeros_like(delivered),
        )
        return _MealMPCState(
            estimator=self.meal_estimator.init(self.model, sensed),
            delivered_mU_min=jnp.full(self.dead_time_samples + 1, delivered),
            reported=jnp.ones(self.dead_time_samples, bool),
            announced_g=jnp.zeros(self.dead_time_samples),
            planned=jnp.zeros(self.moves),
            lasting_mg_min=jnp.zeros_like(delivered),
            to_come=no_meals_to_come(observation),
        )

    def step(self, state: _MealMPCState, observation: Observation) -> tuple[_MealMPCState, Decision]:
        """Estimate the state at the time of the reading, predict to this sample, plan, and make the first move."""
        state, decision, _ = self.explained_step(state, observation)
        return state, decision

    def explained_step(
        self, state: _MealMPCState, observation: Observation
    ) -> tuple[_MealMPCState, Decision, MealEstimate]:
        """Decision of `step`, with the estimate on which the dose rests, of the time of the reading."""
        planned = self._planned(state, observation)
        delivered = planned.delivered_mU_min
        wanted = jnp.where(planned.sound, delivered + planned.moves[0], jnp.nan)
        decision = decide(wanted, delivered, self.limits, planned.known, planned.converged)
        return planned.state, decision, planned.estimate

    def forecast(self, state: _MealMPCState, observation: Observation) -> DoseForecast:
        """Forecast to the prediction horizon under all planned moves, and the cautious one, if a meal ended now."""
        of = self._planned(state, observation)
        p, m = self.horizon, self.moves
        rates = of.delivered_mU_min + jnp.cumsum(jnp.concatenate([of.moves, jnp.zeros(p - m)]))
        expected, cautious = self._forecast().glucose_mg_dl(of.now, of.lasting_mg_min, of.variance, rates)
        now = self.model.glucose_mg_dl(of.now.x)
        return DoseForecast(
            ahead_min=self.sample_time_min * jnp.arange(p + 1.0),
            glucose_mg_dl=jnp.append(now, expected),
            insulin_mU_min=jnp.append(rates, rates[-1]),
            others_mg_dl={"cautious": jnp.append(now, cautious)},
        )

    def _planned(self, state: _MealMPCState, observation: Observation) -> _Planned:
        """Estimate the state at the time of the reading, predict to this sample, and plan."""
        known = is_known(observation)
        delivered = delivered_since(observation, state.delivered_mU_min[-1])
        rates = jnp.append(state.delivered_mU_min[1:], delivered)
        reported = jnp.append(state.reported, jnp.isfinite(observation.delivered_mU_min))
        to_come, begins = hear(state.to_come, observation, observation.announced_carbs_g, self.sample_time_min)
        announced = jnp.append(state.announced_g, begins)
        sensed = Sensed(
            glucose_mg_dl=jnp.where(known, observation.glucose_mg_dl, 0.0),
            known=known,
            insulin_mU_min=rates[0],
            reported=reported[0],
            announced_carbs_g=announced[0],
            time_of_day_min=self._time_of_reading(observation),
        )
        estimator_state, estimate = self.meal_estimator.step(self.model, state.estimator, sensed)
        unexpected = self.expected.without(estimate, 1.0 - self.anticipation, sensed.time_of_day_min)
        forecast = self._forecast()
        now = forecast.to_this_sample(unexpected, rates[1:], announced[1:])
        lasting = self._learned(state.lasting_mg_min, estimate, observation.setpoint_mg_dl, known)
        variance = self.R + unexpected.noise_mg_dl**2
        moves, converged = self._plan(
            forecast, now, unexpected, variance, lasting, state.planned, observation.setpoint_mg_dl, delivered
        )

        fresh = self.init(observation)
        sound = _finite(estimator_state) & is_of_a_person(self.model.glucose_mg_dl(estimate.x))
        estimator_state = jax.tree.map(
            lambda present, new: jnp.where(sound, present, new), estimator_state, fresh.estimator
        )
        planned = jnp.where(sound, jnp.append(moves[1:], 0.0), 0.0)
        state = _MealMPCState(
            estimator=estimator_state,
            delivered_mU_min=rates,
            reported=reported[1:],
            announced_g=announced[1:],
            planned=planned,
            lasting_mg_min=jnp.where(sound, lasting, 0.0),
            to_come=to_come,
        )
        return _Planned(state, estimate, sound, known, delivered, now, lasting, variance, moves, converged)

    def _learned(self, lasting: jax.Array, estimate: MealEstimate, setpoint: jax.Array, known: jax.Array) -> jax.Array:
        """The lasting appearance a sample later, which nears the unexplained one while the person is at steady state.

        Rest is glucose near the setpoint, an empty gut, no meal, and insulin that arrives.
        """
        lasting = jnp.where(jnp.isfinite(lasting), jnp.clip(lasting, 0.0, _LARGEST_LASTING_MG_MIN), 0.0)
        away = (self.model.glucose_mg_dl(estimate.x) - setpoint) / _AT_REST_MG_DL
        still = 1.0 / ((1.0 + away**2) * (1.0 + jnp.maximum(estimate.stomach.gut_mg, 0.0) / _AT_REST_MG))
        rests = jnp.where(known, still * (1.0 - estimate.eating) * (1.0 - estimate.lost), 0.0)
        pace = -math.expm1(-self.sample_time_min / _LASTS_MIN) * rests
        return jnp.clip(lasting + pace * (estimate.disturbance_mg_min - lasting), 0.0, _LARGEST_LASTING_MG_MIN)

    def _time_of_reading(self, observation: Observation) -> jax.Array | None:
        """Time of day of which the reading speaks, None if it is not known or makes no difference."""
        if not self.needs_time_of_day or observation.time_of_day_min is None:
            return None
        return earlier(observation.time_of_day_min, self.dead_time_samples * self.sample_time_min)

    def _forecast(self) -> MealForecast:
        return MealForecast(
            model=self.model,
            ends=self.ends,
            doubt=self.doubt,
            gut_doubt=self.gut_doubt,
            dead_time_samples=self.dead_time_samples,
            sample_time_min=self.sample_time_min,
        )

    def _plan(
        self,
        forecast: MealForecast,
        now: Ahead,
        estimate: MealEstimate,
        variance: jax.Array,
        lasting: jax.Array,
        moves: jax.Array,
        setpoint: jax.Array,
        delivered: jax.Array,
    ) -> tuple[jax.Array, jax.Array]:
        """Moves that improve the given ones, and whether they are the minimiser of the last quadratic program."""
        m, p = self.moves, self.horizon
        uncertain = jnp.sqrt(estimate.eating * (1.0 - estimate.eating) + _LASTING_DOUBT)
        low_mg_dl = setpoint - self.caution_mg_dl * _CAUTIOUS_VARIANCE / (variance + _CAUTIOUS_VARIANCE)
        weight = jnp.concatenate([jnp.full(p, self.caution_weight * uncertain), jnp.full(p, self.floor_weight)])
        least = jnp.concatenate([jnp.full(p, low_mg_dl), jnp.full(p, self.glucose_floor_mg_dl)])

        def glucose(moves: jax.Array) -> tuple[jax.Array, jax.Array]:
            rates = delivered + jnp.cumsum(jnp.concatenate([moves, jnp.zeros(p - m)]))
            both = forecast.glucose_mg_dl(now, lasting, variance, rates)
            return both, both

        limits = {
            "max_move": self.limits.max_change_mU_min,
            "u_min": self.limits.min_mU_min,
            "u_max": self.limits.max_mU_min,
        }
        moves, converged = limit_moves(moves, delivered, **limits), jnp.asarray(True)
        for _ in range(self.iterations):
            J, (likely, if_it_ends) = jax.jacfwd(glucose, has_aux=True)(moves)
            low = jnp.concatenate([J[1], J[1]])
            weighted = self.output_weight * J[0]
            solution = minimise_moves_above_floor(
                weighted.T @ weighted + self.move_weight**2 * jnp.eye(m),
                -weighted.T @ (self.output_weight * (setpoint - likely + J[0] @ moves)),
                low,
                least - jnp.concatenate([if_it_ends, if_it_ends]) + low @ moves,
                weight,
                delivered,
                **limits,
            )
            moves, converged = solution.moves, solution.converged
        return moves, converged


def _finite(tree: Any) -> jax.Array:
    sound = jnp.asarray(True)
    for leaf in jax.tree.leaves(tree):
        sound = sound & jnp.all(jnp.isfinite(leaf))
    return sound


@checked
@on_host("its estimator of meals is made with NumPy")
def design_meal_mpc(
    model: FedModel,
    tuning: MealTuning | None = None,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    habits: MealHabits | None = None,
    estimator: EstimatorComponent | None = None,
    disturbance_variance: float = MealMPC.disturbance_variance,
    measurement_variance: float = 1.45,
    dead_time_samples: int = 0,
) -> MealMPC:
    """`MealMPC` on a nonlinear model, with estimated and announced meals.

    Parameters
    ----------
    model : FedModel
        Internal model of the person; `simulation.internal_model.nonlinear_model` makes one from a patient, and
        `models.sensor_lag.behind_lag` one of a sensor that lags.
    tuning, limits
        As for `design_mpc_se`, with a `MealTuning`.
    habits : MealHabits, optional
        Prior knowledge of meals.
    estimator : EstimatorComponent, optional
        One of `estimation.unknown_meal`; the moving horizon by default.
    disturbance_variance : float
        Variance of the change of unexplained glucose per sample, (mg/min)^2.
    measurement_variance : float
        R of a reading, (mg/dl)^2.
    dead_time_samples : int
        Dead time of the readings that the controller knows of.

    Raises
    ------
    ValueError
        For a value outside its bounds, or a dead time that is negative.
    """
    settings, min_horizon = MealMPC().tuned(
        tuning,
        estimator=MealMPC.estimator if estimator is None else estimator,
        disturbance_variance=disturbance_variance,
    )
    return settings.of_model(
        model,
        limits,
        measurement_variance,
        habits=MealHabits() if habits is None else habits,
        dead_time_samples=dead_time_samples,
        min_horizon=min_horizon,
    )


def _measurement_variance(noise_variance: float, estimator: EstimatorComponent) -> float:
    """Variance R for a sensor with white noise: what is beyond a bound is left to an estimator that learns noise."""
    learns = getattr(estimator, "noise_drift", 0.0) > 0.0
    return min(max(noise_variance, _MIN_VARIANCE), _MAX_VARIANCE if learns else math.inf)
