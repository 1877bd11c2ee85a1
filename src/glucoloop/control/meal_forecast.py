"""Forecasts of the meal-aware controller: glucose ahead as expected, and if what is uncertain of it ended now."""

from __future__ import annotations

import dataclasses
from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.estimation.unknown_meal import MealEstimate
from glucoloop.estimation.unknown_meal.disturbed import fading
from glucoloop.meals.stomach import Announced, Gut, Stomach, announce, digest, gut_of, serve
from glucoloop.models.nonlinear import IndividualModel, advance_with_rough_tangents

_DOUBTED_VARIANCE: Final = 3.0
"""(mg/dl)^2 of noise at which half of `gut_doubt` counts."""


@pytree
class Ahead:
    """State of a forecast at one time."""

    x: jax.Array
    stomach: Stomach
    announced: Announced
    eating: jax.Array
    disturbance: jax.Array
    gut: Gut


@pytree
class MealForecast:
    """Forecasts on the model of a person."""

    model: IndividualModel
    ends: jax.Array
    """Probability that a meal under way ends in a sample."""
    doubt: jax.Array | float
    """Share of the unexplained appearance that the second forecast leaves out, as far as it does not last."""
    gut_doubt: jax.Array | float
    """Share of what is in stomach and gut that it leaves out in large noise."""
    dead_time_samples: int = static()
    sample_time_min: float = static()

    def _sample(self, at: Ahead, insulin: jax.Array, goes_on: jax.Array) -> Ahead:
        """One sample of a forecast; `goes_on` is the probability that a meal under way is still served in it."""
        h = self.sample_time_min
        eating = at.eating * goes_on
        announced, served = serve(at.announced, h)
        stomach, appearance = digest(at.stomach, eating + served, h, at.gut)
        x = advance_with_rough_tangents(self.model, at.x, insulin, appearance.at[0].add(at.disturbance))
        disturbance = fading(at.disturbance, at.stomach, stomach)
        return dataclasses.replace(
            at, x=x, stomach=stomach, announced=announced, eating=eating, disturbance=disturbance
        )

    def to_this_sample(self, estimate: MealEstimate, rates: jax.Array, announced: jax.Array) -> Ahead:
        """Predict through the known dead time, under the rates that were delivered since."""
        at = Ahead(
            x=estimate.x,
            stomach=estimate.stomach,
            announced=estimate.announced,
            eating=estimate.eating,
            disturbance=estimate.disturbance_mg_min,
            gut=gut_of(estimate.gut_min, self.sample_time_min),
        )
        for i in range(self.dead_time_samples):
            at = self._sample(at, rates[i], 1.0 - self.ends)
            at = dataclasses.replace(at, announced=announce(at.announced, announced[i]))
        return at

    def glucose_mg_dl(self, now: Ahead, lasting: jax.Array, variance: jax.Array, rates: jax.Array) -> jax.Array:
        """Glucose ``(2, p)`` at the samples ahead, under the rates ``(p,)``: expected, and if a meal ends now.

        In the second a share of what is in stomach and gut is not there, and what is not lasting of the unexplained
        appearance ends, as far as they are doubted.
        """
        goes_on = jnp.stack([1.0 - self.ends, jnp.zeros_like(self.ends)])

        def one(at: Ahead, insulin: jax.Array) -> tuple[Ahead, jax.Array]:
            at = jax.vmap(self._sample, in_axes=(0, None, 0))(at, insulin, goes_on)
            return at, jax.vmap(self.model.glucose_mg_dl)(at.x)

        there = 1.0 - self.gut_doubt * variance / (variance + _DOUBTED_VARIANCE)
        ends = dataclasses.replace(
            now,
            stomach=jax.tree.map(lambda estimator_state: there * estimator_state, now.stomach),
            disturbance=now.disturbance - self.doubt * jnp.maximum(now.disturbance - lasting, 0.0),
        )
        twice = jax.tree.map(lambda *leaves: jnp.stack(leaves), now, ends)
        return jax.lax.scan(one, twice, rates)[1].T
