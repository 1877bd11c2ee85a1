"""What an estimator expects of meals when nothing tells of any, and an estimate without it."""

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
"""After which the expectation of a person at rest has settled."""


@pytree
class Expectation:
    """A person at rest, as an estimator describes him who knows that meals begin now and then."""

    eating: jax.Array
    x: jax.Array
    """Beyond the model's rest."""
    stomach: Stomach

    def without(self, estimate: MealEstimate, taken: jax.Array | float = 1.0) -> MealEstimate:
        """What readings tell of meals, without a share `taken` of what is always expected.

        Expecting a little of a meal at every sample would hold glucose a little below the setpoint. The expectation is
        taken out in proportion to the chance that there is no meal: at rest nothing of it is left, and of a meal that
        is certain nothing is taken.
        """
        share = taken * (1.0 - estimate.eating) / (1.0 - self.eating)
        return dataclasses.replace(
            estimate,
            eating=jnp.clip(estimate.eating - share * self.eating, 0.0, 1.0),
            x=estimate.x - share * self.x,
            stomach=jax.tree.map(lambda held, always: held - share * always, estimate.stomach, self.stomach),
        )


def expectation(estimator: MealEstimator, model: FedModel) -> Expectation:
    """Of an estimator that reads, sample by sample, what it predicts for a person at rest."""
    rest = jnp.asarray(model.glucose_mg_dl(model.state))
    sensed = Sensed(
        glucose_mg_dl=rest,
        known=jnp.asarray(True),
        insulin_mU_min=jnp.asarray(model.insulin_mU_min, float),
        announced_carbs_g=jnp.zeros(()),
    )

    @jax.jit
    def settle(estimator: MealEstimator, model: FedModel) -> MealEstimate:
        def one(state: object, _: None) -> tuple[object, MealEstimate]:
            return estimator.step(model, state, sensed)

        _, estimates = jax.lax.scan(one, estimator.init(model, sensed), None, length=_SAMPLES)
        last: MealEstimate = jax.tree.map(lambda leaf: leaf[-1], estimates)
        return last

    last = settle(estimator, model)
    return Expectation(eating=last.eating, x=last.x - model.state, stomach=last.stomach)
