"""Estimation of meals that are not announced, by an extended Kalman filter with an unknown input.

The rate E at which the stomach empties is a state that walks at random; the gut follows it as Lehmann and Deutsch say,
and the nonlinear model follows the gut::

    E+ = E + w,    q' = E - q / 60,    x' = f(x, u, q / 60),    y = g(x) + v

The filter has no model of the course of a meal: it predicts that the present rate goes on. It is the simple method with
which `moving_horizon` is compared.

References
----------
E. D. Lehmann, T. Deutsch, J. Biomed. Eng. 14, 1992: the gut.
A. H. Jazwinski, Stochastic Processes and Filtering Theory, Academic Press, 1970, ch. 8: the extended filter.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree
from glucoloop.component.setting import About
from glucoloop.estimation.kalman import steady_state_gain
from glucoloop.estimation.unknown_meal.disturbed import (
    LARGEST_INNOVATION_MG_DL,
    Waking,
    check_variances,
    linearised,
    waking,
)
from glucoloop.estimation.unknown_meal.habits import DailyRates, MealHabits
from glucoloop.estimation.unknown_meal.protocol import EstimatorComponent, MealEstimate, Sensed
from glucoloop.meals.lehmann_deutsch import GUT_TIME_CONSTANT_MIN, PLATEAU_MG_MIN
from glucoloop.meals.stomach import (
    SERVED_G_PER_MIN,
    Announced,
    Stomach,
    announce,
    digest,
    empty_stomach,
    nothing_announced,
    ramp_samples,
    serve,
)
from glucoloop.models.nonlinear import FedModel, reading_of
from glucoloop.units import MG_PER_G

_NOTHING: Final = 0.1
"""Share of the plateau below which a rate of emptying is no meal; above one half it is a meal."""
_LARGEST_COVARIANCE: Final = 1e9
"""Largest covariance, so that it stays finite through days without readings."""


class KalmanSettings(EstimatorComponent, name="kalman"):
    """Rate at which the stomach empties, a random walk, by an extended Kalman filter."""

    sources = ("lehmann1992", "jazwinski1970")
    make: ClassVar = "glucoloop.estimation.unknown_meal.kalman:design_meal_kalman"
    emptying_variance: Annotated[
        float, About("Variance of the change of that rate from sample to sample, (mg/min)².", above=0.0)
    ] = 2500.0
    state_variance: Annotated[float, About("Process noise of each state of the model, per sample.", above=0.0)] = 1e-3


@pytree
class _MealKalmanState:
    """State of the estimator."""

    mean: jax.Array
    """(n + 2,) state of the model, gut content q mg, and E mg/min of meals that are not announced."""
    covariance: jax.Array
    """(n + 2, n + 2) covariance of the mean."""
    of_announced: Stomach
    announced: Announced
    emptied_g: jax.Array
    """Carbohydrate emptied since E was last near zero."""
    sure: jax.Array
    """Whether the present emptying counts as a meal."""
    carbs_g: jax.Array
    """Carbohydrate emptied of the latest meal."""


@pytree
class MealKalman:
    """Extended Kalman filter for meals; see `design_meal_kalman`. Implements `MealEstimator`."""

    start: jax.Array
    """(n + 2, n + 2) initial covariance."""
    process_noise: jax.Array
    """(n + 2, n + 2) covariance of the process noise."""
    measurement_variance: jax.Array
    ends: jax.Array
    """Probability that a meal ends in a sample."""
    waking: Waking
    daily: ClassVar[DailyRates | None] = None
    """Rates of meals by the time of day: none, for the filter has no prior of meals."""

    def at_each_rate(self) -> tuple[MealKalman, ...]:
        """The same filter: it has no rate of meals."""
        return (self,)

    def at_noise(self, deviation_mg_dl: float) -> MealKalman:
        """The same filter: it takes all noise for white."""
        return self

    def init(self, model: FedModel, sensed: Sensed) -> _MealKalmanState:
        """Steady state of a fasting person; the unexplained part of the first reading counts as lasting emptying."""
        x, disturbance = self.waking.wake(model, sensed.insulin_mU_min, sensed.glucose_mg_dl, sensed.known)
        none = jnp.zeros_like(disturbance)
        gut = disturbance * GUT_TIME_CONSTANT_MIN
        return _MealKalmanState(
            mean=jnp.concatenate([x, jnp.stack([gut, disturbance])]),
            covariance=self.start,
            of_announced=empty_stomach(none, model.sample_time_min),
            announced=nothing_announced(none),
            emptied_g=none,
            sure=none > 0.0,
            carbs_g=none,
        )

    def step(self, model: FedModel, state: _MealKalmanState, sensed: Sensed) -> tuple[_MealKalmanState, MealEstimate]:
        """Predict the state, correct it by the reading, and derive the estimate of the meal."""
        h = model.sample_time_min
        announced, served = serve(state.announced, h)
        of_announced, known_appearance = digest(state.of_announced, served, h)

        def carry(mean: jax.Array) -> jax.Array:
            E = mean[-1]
            stomach = Stomach(served=_steady(E, h), gut_mg=mean[-2])
            after, appearance = digest(stomach, E / PLATEAU_MG_MIN, h)
            x = model.advance_fed(mean[:-2], sensed.insulin_mU_min, known_appearance + appearance)
            return jnp.concatenate([x, jnp.stack([after.gut_mg, E])])

        F = jax.jacfwd(carry)(state.mean)
        mean = carry(state.mean)
        P = F @ state.covariance @ F.T + self.process_noise
        reading = reading_of(model)
        C = jnp.concatenate([jax.jacfwd(reading)(mean[:-2]), jnp.zeros(2)])
        seen = P @ C
        gain = jnp.where(sensed.known, seen / (C @ seen + self.measurement_variance), 0.0)
        innovation = jnp.where(sensed.known, sensed.glucose_mg_dl - reading(mean[:-2]), 0.0)
        mean = mean + gain * jnp.clip(innovation, -LARGEST_INNOVATION_MG_DL, LARGEST_INNOVATION_MG_DL)
        P = P - jnp.outer(gain, seen)
        P = jnp.clip((P + P.T) / 2.0, -_LARGEST_COVARIANCE, _LARGEST_COVARIANCE)

        share = mean[-1] / PLATEAU_MG_MIN
        goes_on = share > _NOTHING
        emptied = jnp.where(goes_on, state.emptied_g + mean[-1] * h / MG_PER_G, 0.0)
        sure = goes_on & (state.sure | (share > 0.5))
        state = _MealKalmanState(
            mean=mean,
            covariance=P,
            of_announced=of_announced,
            announced=announce(announced, sensed.announced_carbs_g),
            emptied_g=emptied,
            sure=sure,
            carbs_g=jnp.where(sure, emptied, state.carbs_g),
        )
        return state, self._estimate(state, h)

    def _estimate(self, state: _MealKalmanState, sample_time_min: float) -> MealEstimate:
        E, known = state.mean[-1], state.of_announced
        eating = jnp.clip(E / PLATEAU_MG_MIN, 0.0, 1.0)
        return MealEstimate(
            x=state.mean[:-2],
            stomach=Stomach(
                served=known.served + _steady(E, sample_time_min),
                gut_mg=known.gut_mg + state.mean[-2],
            ),
            announced=state.announced,
            disturbance_mg_min=jnp.zeros_like(E),
            eating=eating,
            carbs_g=state.carbs_g,
            remaining_g=eating * SERVED_G_PER_MIN * sample_time_min * (1.0 - self.ends) / self.ends,
            noise_mg_dl=jnp.zeros_like(E),
            gut_min=jnp.full_like(E, GUT_TIME_CONSTANT_MIN),
            lost=jnp.zeros_like(E),
        )


def _steady(E: jax.Array, sample_time_min: float) -> jax.Array:
    """Shares of the samples of a ramp in which food was served, if the present rate of emptying lasts."""
    return jnp.full(ramp_samples(sample_time_min), E / PLATEAU_MG_MIN)


def design_meal_kalman(
    model: FedModel,
    habits: MealHabits | None = None,
    *,
    emptying_variance: float = KalmanSettings.emptying_variance,
    state_variance: float = KalmanSettings.state_variance,
    measurement_variance: float = 1.45,
) -> MealKalman:
    """Design the filter for a model.

    Parameters
    ----------
    habits : MealHabits, optional
        Habits from which the remainder of a meal is predicted; the filter itself does not use them.
    emptying_variance : float
        Variance of the change of E from sample to sample, (mg/min)^2, above 0.
    state_variance : float
        Process noise of each state of the model, per sample, above 0.
    measurement_variance : float
        R, (mg/dl)^2, above 0.

    Raises
    ------
    ValueError
        Outside these bounds, or for a model whose meals cannot be told from glucose.
    """
    habits = MealHabits() if habits is None else habits
    check_variances(emptying_variance, measurement_variance)
    check_variances(state_variance, measurement_variance)
    linear = linearised(model)
    n, h = linear.Gamma.size, model.sample_time_min
    Q = np.diag(np.append(np.full(n + 1, state_variance), emptying_variance))
    # The covariance to begin with is the steady one of the filter about the model's rest. The gut, seen from one
    # sample to the next with E held, is a first-order lag on the way to what appears.
    forget = np.exp(-h / GUT_TIME_CONSTANT_MIN)
    Phi = np.zeros((n + 2, n + 2))
    Phi[:n, :n], Phi[:n, n] = linear.Phi[:n, :n], linear.Phi[:n, n] / GUT_TIME_CONSTANT_MIN
    Phi[n, n], Phi[n, n + 1], Phi[n + 1, n + 1] = forget, GUT_TIME_CONSTANT_MIN * (1.0 - forget), 1.0
    steady = steady_state_gain(Phi, np.append(linear.C[:n], [0.0, 0.0]), Q, measurement_variance)
    return MealKalman(
        start=jnp.asarray(steady.filtered_covariance),
        process_noise=jnp.asarray(Q),
        measurement_variance=jnp.asarray(measurement_variance),
        ends=jnp.asarray(habits.ends(h)),
        waking=waking(linear, measurement_variance),
    )
