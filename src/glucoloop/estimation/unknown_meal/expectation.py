"""Expectation of an estimator of meals at steady state, and an estimate from which it is removed."""

from __future__ import annotations

import dataclasses
from typing import Final

from glucoloop._lazy_jax import jax, jit, jnp
from glucoloop._pytree import pytree
from glucoloop.estimation.noise_level import LEVELS_MG_DL, shares
from glucoloop.estimation.unknown_meal.habits import DailyRates
from glucoloop.estimation.unknown_meal.protocol import MealEstimate, MealEstimator, Sensed
from glucoloop.meals.stomach import Stomach
from glucoloop.models.nonlinear import FedModel

_SAMPLES: Final = 60
"""Number of samples after which the expectation of a person at steady state has settled."""


@pytree
class Expectation:
    """A person at steady state as described by an estimator that assumes that meals begin now and then.

    The noisier the sensor, the less do readings at steady state say against a meal, and the fewer meals may be
    expected. So each value is there for each of the sizes of the sensor's error in `estimation.noise_level`, on its
    first axis. Where the rate of meals depends on the time of day, an axis of the rates comes before it.
    """

    eating: jax.Array
    x: jax.Array
    """State, as its difference from the model's rest."""
    stomach: Stomach
    daily: DailyRates | None = None

    def _at(self, noise_mg_dl: jax.Array, time_of_day_min: jax.Array | None) -> Expectation:
        share, now = shares(noise_mg_dl), self
        if self.daily is not None:
            now = self.daily.at(dataclasses.replace(self, daily=None), time_of_day_min)
        at_noise: Expectation = jax.tree.map(lambda leaf: jnp.tensordot(share, leaf, axes=1), now)
        return at_noise

    def without(
        self,
        estimate: MealEstimate,
        taken: jax.Array | float = 1.0,
        time_of_day_min: jax.Array | None = None,
    ) -> MealEstimate:
        """Estimate without a share `taken` of the meal that is always expected.

        Expecting a little of a meal at every sample would hold glucose a little below the setpoint. The expectation is
        removed in proportion to the probability that there is no meal: all of it at steady state, and nothing during a
        meal that is certain.
        """
        expected = self._at(estimate.noise_mg_dl, time_of_day_min)
        share = taken * (1.0 - estimate.eating) / (1.0 - expected.eating)
        return dataclasses.replace(
            estimate,
            eating=jnp.clip(estimate.eating - share * expected.eating, 0.0, 1.0),
            x=estimate.x - share * expected.x,
            stomach=jax.tree.map(lambda stomach, always: stomach - share * always, estimate.stomach, expected.stomach),
        )


def expectation(estimator: MealEstimator, model: FedModel) -> Expectation:
    """Expectation of an estimator that reads, sample by sample, what it predicts for a person at steady state."""
    each = [_at_levels(one, model) for one in estimator.at_each_rate()]
    last = each[0] if estimator.daily is None else _stacked(each)
    return Expectation(eating=last.eating, x=last.x - model.state, stomach=last.stomach, daily=estimator.daily)


def _at_levels(estimator: MealEstimator, model: FedModel) -> MealEstimate:
    """Last estimates at steady state, for each size of the sensor's error."""
    return _stacked([_at_rest(estimator.at_noise(deviation), model) for deviation in LEVELS_MG_DL])


def _stacked(estimates: list[MealEstimate]) -> MealEstimate:
    stacked: MealEstimate = jax.tree.map(lambda *leaves: jnp.stack(leaves), *estimates)
    return stacked


@jit()
def _at_rest(estimator: MealEstimator, model: FedModel) -> MealEstimate:
    """Last estimate of a person at steady state."""
    sensed = Sensed(
        glucose_mg_dl=jnp.asarray(model.glucose_mg_dl(model.state)),
        known=jnp.asarray(True),
        insulin_mU_min=jnp.asarray(model.insulin_mU_min, float),
        reported=jnp.asarray(True),
        announced_carbs_g=jnp.zeros(()),
    )

    def one(state: object, _: None) -> tuple[object, MealEstimate]:
        return estimator.step(model, state, sensed)

    _, estimates = jax.lax.scan(one, estimator.init(model, sensed), None, length=_SAMPLES)
    last: MealEstimate = jax.tree.map(lambda leaf: leaf[-1], estimates)
    return last
