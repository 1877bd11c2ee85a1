"""What an estimator of unknown meals is, and what it says."""

from __future__ import annotations

from typing import Any, Protocol

import jax

from glucoloop._pytree import pytree
from glucoloop.meals.announced import Announced
from glucoloop.meals.stomach import Stomach
from glucoloop.models.nonlinear import FedModel


@pytree
class MealEstimate:
    """A person at a sample, as far as glucose tells; expected values."""

    x: jax.Array
    """(n,) state of the model."""
    stomach: Stomach
    """What has been eaten, of meals that were announced and that were not."""
    announced: Announced
    """What is still to be served of announced meals."""
    disturbance_mg_min: jax.Array
    """Appearance of glucose that no meal explains; it may be negative."""
    eating: jax.Array
    """Probability that a meal that nobody announced is being served, 0 to 1."""
    carbs_g: jax.Array
    """Size so far of the latest meal that nobody announced; 0 before one is likely."""
    remaining_g: jax.Array
    """How much of it is likely still to come."""


@pytree
class Sensed:
    """What an estimator is told at a sample."""

    glucose_mg_dl: jax.Array
    known: jax.Array
    """Whether that is a reading to go by."""
    insulin_mU_min: jax.Array
    """Rate that was delivered since the last sample."""
    announced_carbs_g: jax.Array
    """Of a meal that begins during the coming sample."""


class MealEstimator(Protocol):
    """Readings in, estimates out. Designed once; `step` never raises. The state is any pytree."""

    def init(self, model: FedModel, sensed: Sensed) -> Any:
        """State before the first sample, of a person at rest."""
        ...

    def step(self, model: FedModel, state: Any, sensed: Sensed) -> tuple[Any, MealEstimate]:
        """Carry the state to this sample and correct it by the reading."""
        ...
