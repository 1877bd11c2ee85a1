"""Expectation of an estimator of meals at rest, and an estimate from which it is removed."""

from __future__ import annotations

import dataclasses
from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.estimation.unknown_meal.protocol import MealEstimate, MealEstimator, Sensed
from glucoloop.meals.stomach import Stomach
from glucoloop.models.nonlinear import FedModel

_SAMPLES: Final = 60
"""Number of samples after which the expectation of a person at rest has settled."""


@pytree
class Expectation:
    """A person at rest as described by an estimator that assumes that meals begin now and then."""

    eating: jax.Array
    x: jax.Array
    """State, as its difference from the model's rest."""
    stomach: Stomach

    def without(self, estimate: MealEstimate, taken: jax.Array | float = 1.0) -> MealEstimate:
        """Estimate without a share `taken` of the meal that is always expected.

        Expecting a little of a meal at every sample would hold glucose a little below the setpoint. The expectation is
        removed in proportion to the probability that there is no meal: all of it at rest, and nothing during a meal
        that is certain.
        """
        share = taken * (1.0 - estimate.eating) / (1.0 - self.eating)
        return dataclasses.replace(
            estimate,
            eating=jnp.clip(estimate.eating - share * self.eating, 0.0, 1.0),
            x=estimate.x - share * self.x,
            stomach=jax.tree.map(lambda held, always: held - share * always, estimate.stomach, self.stomach),
        )


def expectation(estimator: MealEstimator, model: FedModel) -> Expectation:
    """Expectation of an estimator whose readings are, sample by sample, those that it predicts for a person at rest."""
    last = _settled(estimator, model)
    return Expectation(eating=last.eating, x=last.x - model.state, stomach=last.stomach)


@jax.jit
def _settled(estimator: MealEstimator, model: FedModel) -> MealEstimate:
    """Last estimate of a person at rest."""
    sensed = Sensed(
        glucose_mg_dl=jnp.asarray(model.glucose_mg_dl(model.state)),
        known=jnp.asarray(True),
        insulin_mU_min=jnp.asarray(model.insulin_mU_min, float),
        announced_carbs_g=jnp.zeros(()),
    )

    def one(state: object, _: None) -> tuple[object, MealEstimate]:
        return estimator.step(model, state, sensed)

    _, estimates = jax.lax.scan(one, estimator.init(model, sensed), None, length=_SAMPLES)
    last: MealEstimate = jax.tree.map(lambda leaf: leaf[-1], estimates)
    return last
