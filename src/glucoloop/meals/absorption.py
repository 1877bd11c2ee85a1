"""Meals together with the gut that absorbs them, of either kind, for one person and for many.

An `Absorption` knows the meals and gives the moments of the appearance, for a whole run or sample by sample. A
`Digestion` carries the gut of a person in the loop of a cohort, where what is eaten is an input.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import jax
import numpy as np

from glucoloop.meals.ingestion import Ingestion
from glucoloop.meals.jumps import JumpsInSteps
from glucoloop.meals.linear import absorb_linearly, linear_digestion
from glucoloop.meals.moments import points_of_sample
from glucoloop.meals.ode import OdeDigestion, absorb_by_equations, eaten_in_points
from glucoloop.meals.protocol import Eaten, MealModel, OdeMealModel
from glucoloop.native.targets import FUSED
from glucoloop.sparse import Sparse


class Absorption(Protocol):
    """Meals together with the gut that absorbs them; a pytree."""

    @property
    def state(self) -> Any:
        """State of the gut before the coming sample."""

    def goes_on(self, state: Any) -> Absorption:
        """The same meals with the gut in another state, that before the coming sample."""

    def moments(self, samples: int, substeps: int, step_min: float) -> jax.Array:
        """Moments of the appearance over every step of a run, ``(samples, substeps, 3, ...)``."""

    def at_sample(self, index: jax.Array, substeps: int, step_min: float) -> tuple[jax.Array, Any]:
        """The same of the coming sample, which has the number `index`, and the state of the gut after it."""

    def emptying_mg_min(self, samples: int, sample_time_min: float) -> jax.Array:
        """Rate at which the stomach empties at every sample of a run, ``(samples, ...)``."""


class Digestion(Protocol):
    """A gut that is carried from sample to sample; a pytree whose numbers are those that vary between people."""

    @property
    def inputs(self) -> tuple[int, int]:
        """Shape of what reaches one person's gut in a sample."""

    def init(self) -> jax.Array:
        """State of one person who has eaten nothing."""

    def sample(self, state: jax.Array, inputs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Digestion of one person over one sample: the state at its end, and the moments ``(substeps, 3)``."""


def absorb(model: MealModel, eaten: Eaten) -> Absorption:
    """Combine meals with the meal model that absorbs them; with a model of people, meals have an axis of people too."""
    return absorb_by_equations(model, eaten) if isinstance(model, OdeMealModel) else absorb_linearly(model, eaten)


def fasting() -> Absorption:
    """Absorption without any meal, the same for every gut."""
    none = np.zeros(0)
    return absorb(Ingestion(), Eaten(t_min=none, carbs_g=none, eating_min=none))


def digestion(model: MealModel, substeps: int, step_min: float) -> Digestion:
    """Digestion with a gut, of one person or of many, for samples of so many steps."""
    if isinstance(model, OdeMealModel):
        return OdeDigestion(model=model, substeps=substeps, sample_time_min=substeps * step_min)
    made: Digestion = linear_digestion(model, substeps, step_min)
    return made


def digestion_inputs(
    model: MealModel, eaten: Eaten, substeps: int, step_min: float, products: str = FUSED
) -> Callable[[int, int], Sparse]:
    """Inputs of the `digestion` of people with meals ``(meals, people)``, piece by piece of a run.

    The function takes the number of a piece's first sample and the number of its samples, and gives
    ``(samples, *inputs, people)``.
    """
    if not isinstance(model, OdeMealModel):
        jumps = JumpsInSteps(absorb_linearly(model, eaten), step_min, products)

        def of_jumps(first: int, samples: int) -> Sparse:
            table = jumps.table(first * substeps, samples * substeps)
            return table.reshaped(samples, substeps, table.shape[1])

        return of_jumps
    points = points_of_sample(substeps * step_min)
    point_min = substeps * step_min / points

    def of_points(first: int, samples: int) -> Sparse:
        eating = eaten_in_points(eaten, samples * points, point_min, first=first * points)
        return eating.reshaped(samples, points, 2)

    return of_points
