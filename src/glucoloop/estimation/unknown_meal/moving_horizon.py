"""Moving-horizon estimation of meals that are not announced, by enumeration.

A meal of Lehmann and Deutsch is two events: it begins, and it ends. Over the last L samples one of them may have
happened, at any sample or not at all. Each possibility is a hypothesis with a state of its own, which the nonlinear
model carries on with the meal that it stands for, and with a probability, which each reading changes by Bayes' rule::

    fasting    no meal for L samples, or more             begun j ago    j = 1 .. L
    eating     a meal for L samples, or more              ended j ago    j = 1 .. L

Events older than L samples no longer distinguish hypotheses: those that meet are merged to their mean.
Within a hypothesis a steady Kalman gain corrects the state, a disturbance, and a correlated error of the sensor whose
size is learned; see `estimation.noise_level`. The disturbance is glucose that appears for no known reason; it takes up
what the model gets wrong, within a bound: much insulin without an effect has not arrived, rather than met with glucose.

With the events of the horizon enumerated and the merged state as what is known before it, this is moving-horizon
estimation with a discrete decision; with the weights kept in place of the best alone, it is the interacting
multiple-model filter on the age of the last event.

References
----------
E. D. Lehmann, T. Deutsch, J. Biomed. Eng. 14, 1992: the meal.
C. V. Rao, J. B. Rawlings, D. Q. Mayne, "Constrained state estimation for nonlinear discrete-time systems: stability and
moving horizon approximations", IEEE Trans. Autom. Control 48(2), 2003.
H. A. P. Blom, Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Trans. Autom. Control 33(8), 1988.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree, static
from glucoloop.estimation.noise_level import NoisyFilters, noisy_filters
from glucoloop.estimation.unknown_meal.disturbed import (
    LARGEST_INNOVATION_MG_DL,
    Waking,
    check_variances,
    fading,
    linearised,
    waking,
)
from glucoloop.estimation.unknown_meal.habits import MealHabits
from glucoloop.estimation.unknown_meal.protocol import MealEstimate, Sensed
from glucoloop.meals.announced import Announced, announce, nothing_announced, serve
from glucoloop.meals.stomach import SERVED_G_PER_MIN, Stomach, digest, empty_stomach
from glucoloop.models.nonlinear import FedModel

LONGEST_HORIZON: Final = 100
_LEAST: Final = 1e-12
"""Probability below which no hypothesis falls, so that each can come back."""
_STRAY: Final = 1e-3
"""Likelihood that is added to each hypothesis, so that a reading far from all of them does not tell them apart."""


@pytree
class Hypothesis:
    """State of each hypothesis; the axis of hypotheses is the last one."""

    x: jax.Array
    """(n, ...) state of the model."""
    stomach: Stomach
    disturbance_mg_min: jax.Array
    carbs_g: jax.Array
    """Carbohydrate served so far of the meal that the hypothesis is about, the latest one."""
    error_mg_dl: jax.Array
    """Correlated error of the sensor."""


@pytree
class MealHorizonState:
    """State of the estimator."""

    hypotheses: Hypothesis
    probability: jax.Array
    """(2 L + 2,) probability of each hypothesis."""
    announced: Announced
    noise_mg_dl: jax.Array
    """Estimated standard deviation of the correlated error of the sensor."""


@pytree
class MealHorizon:
    """Moving-horizon estimator of meals; see `design_meal_horizon`. Implements `MealEstimator`."""

    filters: NoisyFilters
    """Gains for the state, the disturbance and the sensor's error, at each size of the error."""
    largest_disturbance_mg_min: jax.Array | float
    """Largest disturbance that is believed, to either side."""
    begins: jax.Array
    """Probability that a meal begins in a sample."""
    ends: jax.Array
    """Probability that a meal under way ends in a sample."""
    ends_unseen: jax.Array | float
    """The same without a reading, which could tell that it goes on."""
    waking: Waking
    horizon: int = static()

    def at_noise(self, deviation_mg_dl: float) -> MealHorizon:
        """The same estimator for a sensor whose correlated error has a known standard deviation."""
        return dataclasses.replace(self, filters=self.filters.fixed(deviation_mg_dl))

    def init(self, model: FedModel, sensed: Sensed) -> MealHorizonState:
        """State of a fasting person at rest."""
        x, disturbance = self.waking.wake(model, sensed.insulin_mU_min, sensed.glucose_mg_dl, sensed.known)
        fasting = Hypothesis(
            x=x,
            stomach=empty_stomach(disturbance, model.sample_time_min),
            disturbance_mg_min=disturbance,
            carbs_g=jnp.zeros_like(disturbance),
            error_mg_dl=jnp.zeros_like(disturbance),
        )
        number = 2 * self.horizon + 2
        return MealHorizonState(
            hypotheses=jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, number)), fasting),
            probability=jnp.asarray(np.append(1.0, np.full(number - 1, _LEAST))),
            announced=nothing_announced(disturbance),
            noise_mg_dl=jnp.zeros_like(disturbance),
        )

    def step(self, model: FedModel, state: MealHorizonState, sensed: Sensed) -> tuple[MealHorizonState, MealEstimate]:
        """Age the hypotheses by a sample, carry them with the model, and correct them by the reading."""
        announced, served = serve(state.announced, model.sample_time_min)
        # Without a reading nothing may tell that a meal has begun; that one may have ended is the safe side. And who is
        # being served an announced meal does not begin another one.
        begins = jnp.where(sensed.known & (served == 0.0), self.begins, 0.0)
        ends = jnp.where(sensed.known, self.ends, self.ends_unseen)
        hypotheses, probability = self._age(state.hypotheses, state.probability, begins, ends)
        hypotheses = self._carry(model, hypotheses, sensed.insulin_mU_min, served)
        hypotheses, probability, noise = self._correct(model, hypotheses, probability, state.noise_mg_dl, sensed)
        announced = announce(announced, sensed.announced_carbs_g)
        state = MealHorizonState(hypotheses=hypotheses, probability=probability, announced=announced, noise_mg_dl=noise)
        return state, self._estimate(state, model.sample_time_min)

    def _eating(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Indicator of the hypotheses in which a meal is being served."""
        L = self.horizon
        return np.concatenate([[0.0], np.ones(L), [1.0], np.zeros(L)])

    def _age(self, held: Hypothesis, p: jax.Array, begins: jax.Array, ends: jax.Array) -> tuple[Hypothesis, jax.Array]:
        """Age all events by a sample: the oldest hypotheses are merged, and new events may happen."""
        L = self.horizon
        eats = self._eating()
        not_eating, eating = jnp.sum(p * (1.0 - eats)), jnp.sum(p * eats)

        def aged(leaf: jax.Array) -> jax.Array:
            def mean(which: np.ndarray[Any, Any]) -> jax.Array:
                share = p * which
                return jnp.sum(leaf * share, axis=-1) / jnp.sum(share)

            none = np.zeros(2 * L + 2)
            fasting, feasting = none.copy(), none.copy()
            fasting[[0, -1]] = 1.0
            feasting[[L, L + 1]] = 1.0
            begun, ended = mean(1.0 - eats), mean(eats)
            parts = [mean(fasting), begun, leaf[..., 1:L], mean(feasting), ended, leaf[..., L + 2 : 2 * L + 1]]
            alone = (0, 1, 3, 4)
            return jnp.concatenate([part[..., None] if i in alone else part for i, part in enumerate(parts)], axis=-1)

        passed = jnp.concatenate(
            [
                ((p[0] + p[-1]) * (1.0 - begins))[None],
                (not_eating * begins)[None],
                p[1:L] * (1.0 - ends),
                ((p[L] + p[L + 1]) * (1.0 - ends))[None],
                (eating * ends)[None],
                p[L + 2 : -1] * (1.0 - begins),
            ]
        )
        later: Hypothesis = jax.tree.map(aged, held)
        just_begun = np.arange(2 * L + 2) == 1
        return dataclasses.replace(later, carbs_g=jnp.where(just_begun, 0.0, later.carbs_g)), passed

    def _carry(self, model: FedModel, held: Hypothesis, insulin: jax.Array, announced: jax.Array) -> Hypothesis:
        """Carry each hypothesis through the sample that has passed."""
        h, eats = model.sample_time_min, self._eating()
        stomach, appearance = digest(held.stomach, announced + eats, h)
        appearance = appearance.at[0].add(held.disturbance_mg_min)
        x = jax.vmap(model.advance_fed, in_axes=(-1, None, -1), out_axes=-1)(held.x, insulin, appearance)
        return Hypothesis(
            x=x,
            stomach=stomach,
            disturbance_mg_min=fading(held.disturbance_mg_min, held.stomach, stomach),
            carbs_g=held.carbs_g + eats * (SERVED_G_PER_MIN * h),
            error_mg_dl=self.filters.correlation * held.error_mg_dl,
        )

    def _correct(
        self, model: FedModel, held: Hypothesis, p: jax.Array, noise: jax.Array, sensed: Sensed
    ) -> tuple[Hypothesis, jax.Array, jax.Array]:
        """Correct the states by the gain, the probabilities by Bayes' rule, and the size of the sensor's error."""
        predicted = jax.vmap(model.glucose_mg_dl, in_axes=-1)(held.x) + held.error_mg_dl
        innovation = jnp.where(sensed.known, sensed.glucose_mg_dl - predicted, 0.0)
        gain, variance = self.filters.at(noise)
        likelihood = jnp.exp(-0.5 * innovation**2 / variance) + _STRAY
        moved = jnp.clip(innovation, -LARGEST_INNOVATION_MG_DL, LARGEST_INNOVATION_MG_DL)
        noise = self.filters.learn(noise, jnp.sum(p * moved) / jnp.sqrt(variance), sensed.known)
        p = p * likelihood
        p = jnp.maximum(p / jnp.sum(p), _LEAST)
        largest = self.largest_disturbance_mg_min
        corrected = Hypothesis(
            x=held.x + gain[:-2, None] * moved,
            stomach=held.stomach,
            disturbance_mg_min=jnp.clip(held.disturbance_mg_min + gain[-2] * moved, -largest, largest),
            carbs_g=held.carbs_g,
            error_mg_dl=held.error_mg_dl + gain[-1] * moved,
        )
        return corrected, p / jnp.sum(p), noise

    def _estimate(self, state: MealHorizonState, sample_time_min: float) -> MealEstimate:
        """Expected values over the hypotheses."""
        p = state.probability
        mean: Hypothesis = jax.tree.map(lambda leaf: jnp.sum(leaf * p, axis=-1), state.hypotheses)
        eats = self._eating()
        eating = jnp.sum(p * eats)
        # Of two meals, that of the likelier half: one that may have begun just now says nothing of the one before.
        share = p * jnp.where(eating > 0.5, eats, 1.0 - eats)
        carbs_g = jnp.sum(share * state.hypotheses.carbs_g) / jnp.sum(share)
        per_sample = SERVED_G_PER_MIN * sample_time_min
        return MealEstimate(
            x=mean.x,
            stomach=mean.stomach,
            announced=state.announced,
            disturbance_mg_min=mean.disturbance_mg_min,
            eating=eating,
            carbs_g=carbs_g,
            remaining_g=eating * per_sample * (1.0 - self.ends) / self.ends,
            noise_mg_dl=state.noise_mg_dl,
        )


def design_meal_horizon(
    model: FedModel,
    habits: MealHabits | None = None,
    *,
    horizon: int = 10,
    disturbance_variance: float = 8.0,
    measurement_variance: float = 1.45,
    largest_disturbance_mg_min: float = 100.0,
    noise_pace: float = 0.2,
    ends_unseen: float = 0.3,
) -> MealHorizon:
    """Design the estimator for a model.

    Parameters
    ----------
    model : FedModel
    habits : MealHabits, optional
    horizon : int
        L, samples over which the beginning or the end of a meal is searched for, 2 to 100.
    disturbance_variance : float
        Variance of the change of the disturbance from sample to sample, (mg/min)^2, above 0.
    measurement_variance : float
        R, (mg/dl)^2, above 0.
    largest_disturbance_mg_min : float
        Largest disturbance that is believed, to either side, above 0.
    noise_pace : float
        Pace at which the size of a correlated error is learned, 0 to 1; see `estimation.noise_level`.

    Raises
    ------
    ValueError
        Outside these bounds, or for a model whose disturbance cannot be told from glucose.
    """
    habits = MealHabits() if habits is None else habits
    if isinstance(horizon, bool) or not isinstance(horizon, int) or not 2 <= horizon <= LONGEST_HORIZON:
        raise ValueError(
            f"a meal horizon of {horizon} samples is not possible; give a whole number from 2 to {LONGEST_HORIZON}"
        )
    check_variances(disturbance_variance, measurement_variance)
    if not 0.0 < largest_disturbance_mg_min < np.inf:
        raise ValueError(
            f"a largest disturbance of {largest_disturbance_mg_min:g} mg/min is not possible; "
            "give a finite value above 0"
        )
    linear = linearised(model)
    n = linear.Gamma.size
    Q = np.zeros((n + 1, n + 1))
    Q[n, n] = disturbance_variance
    h = model.sample_time_min
    return MealHorizon(
        filters=noisy_filters(linear.Phi, linear.C, Q, measurement_variance, pace=noise_pace),
        largest_disturbance_mg_min=largest_disturbance_mg_min,
        begins=jnp.asarray(habits.begins(h)),
        ends=jnp.asarray(habits.ends(h)),
        ends_unseen=jnp.asarray(max(ends_unseen, habits.ends(h))),
        waking=waking(linear, measurement_variance),
        horizon=horizon,
    )
