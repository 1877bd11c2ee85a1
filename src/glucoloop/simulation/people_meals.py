"""Meals that people of a cohort eat and announce, sample by sample of their loop, and the gut that each of them has."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import varying
from glucoloop.meals.absorption import Digestion, absorb, digestion, digestion_inputs
from glucoloop.meals.models import meal_model_of
from glucoloop.meals.protocol import Eaten, MealModel
from glucoloop.native.targets import FUSED
from glucoloop.patients.protocol import Patient
from glucoloop.simulation.plant import SampleGrid
from glucoloop.sparse import Sparse

Array = npt.NDArray[Any]


class PeopleMeals:
    """Meals and guts of people who are like the `nominal` patient.

    Parameters
    ----------
    nominal, varied : Patient
        As for `Cohort`.
    meals : Eaten or None
        Meals ``(meals,)`` of all people, or None if each has individual ones.
    grid : SampleGrid
        Samples of the loop, from the beginning of the warm-up on.
    warm_up_min : float
        Time of the warm-up, from whose end the times of meals count.
    substeps : int
        Steps of the integrator in a sample.
    instead : MealModel, optional
        Meal model of all people, in place of their own.
    announced, own_announcements : bool
        Whether meals are announced, and whether what is announced differs between people.
    counted : bool
        Whether metrics are told what is eaten at each sample.
    products : str
        Rounding of products, see `native.targets`.
    """

    def __init__(
        self,
        nominal: Patient,
        varied: Patient,
        meals: Eaten | None,
        grid: SampleGrid,
        *,
        warm_up_min: float,
        substeps: int,
        instead: MealModel | None = None,
        announced: bool = False,
        own_announcements: bool = False,
        counted: bool = False,
        products: str = FUSED,
    ) -> None:
        self._meals, self._grid, self._warm_up_min, self._instead = meals, grid, warm_up_min, instead
        self._substeps, self._step_min, self._products = substeps, grid.sample_time_min / substeps, products
        one, varied_gut = self.gut(nominal), self.gut(varied)
        self.digestion = self.digestion_of(nominal)
        """Digestion of the nominal patient."""
        self.varies = varying(self.digestion_of(varied), self.digestion)
        """Truths that tell which of its numbers differ between people."""
        self.individual = meals is None or any(varying(varied_gut, one))
        """Whether each person has a gut in the loop, for meals or guts differ."""
        self.announced_each = announced and (self.individual or own_announcements)
        """Whether what is announced reaches each person."""
        self.counted_each = counted and self.individual
        """Whether what is eaten at each sample reaches each person."""
        samples = grid.samples
        self.moments, self.announced_by_sample = np.zeros((samples, substeps, 0)), np.zeros(samples)
        """Moments ``(samples, substeps, 3)`` and announced carbohydrate ``(samples,)`` that reach all people."""
        self.eaten_by_sample = self.announced_by_sample
        """(samples,) carbohydrate of the meals of all people."""
        if meals is not None and not self.individual:
            in_loop = self._in_loop(meals)
            self.moments = np.asarray(absorb(one, in_loop).moments(samples, substeps, self._step_min))
            self.announced_by_sample = _AtSamples(_for_people(in_loop, 1), grid).of(slice(0, samples)).dense()[:, 0]
            self.eaten_by_sample = self.announced_by_sample
        self._first_announced_g = float(self.announced_by_sample[0]) if announced else 0.0

    def gut(self, patient: Patient) -> MealModel:
        """Meal model of a patient in this cohort."""
        return meal_model_of(patient, self._instead)

    def digestion_of(self, patient: Patient) -> Digestion:
        """Digestion of people, numbers trailing."""
        return digestion(self.gut(patient), self._substeps, self._step_min)

    def inputs(
        self,
        patient: Patient,
        people: int,
        meals: Eaten | None,
        announced_g: Array | None,
        announced_min: Array | None,
        everybody: int,
    ) -> tuple[Callable[[slice], dict[str, Any]], Array]:
        """Function of a piece of the run that gives what reaches the first people in it, and what is announced first.

        The `patient` is of `everybody`; for what else is given see `cohort.People`.
        """
        if not (self.individual or self.announced_each):
            return lambda piece: {}, np.full(people, self._first_announced_g)
        if self._meals is not None:
            meals = _for_people(self._meals, people)
        if meals is None:
            raise TypeError("this cohort was made for people with meals of their own; give meals")
        meals = self._in_loop(meals)
        counted_g = meals.carbs_g if announced_g is None else announced_g
        announced_at_min = meals.t_min if announced_min is None else announced_min + self._warm_up_min
        announced = _AtSamples(
            dataclasses.replace(meals, carbs_g=counted_g, t_min=np.maximum(announced_at_min, 0.0)), self._grid
        )
        gut = jax.tree.map(
            lambda leaf: leaf[..., :people] if np.shape(leaf)[-1:] == (everybody,) else leaf, self.gut(patient)
        )
        eaten = _AtSamples(meals, self._grid)
        reaching_gut = digestion_inputs(gut, meals, self._substeps, self._step_min, self._products)

        def inputs(piece: slice) -> dict[str, Any]:
            reaching: dict[str, Any] = {}
            if self.individual:
                reaching["meals"] = reaching_gut(piece.start, piece.stop - piece.start)
            if self.announced_each:
                reaching["told"] = announced.of(piece)
            if self.counted_each:
                reaching["eaten"] = eaten.of(piece)
            return reaching

        return inputs, announced.of(slice(0, 1)).dense()[0] if self.announced_each else np.zeros(people)

    def _in_loop(self, meals: Eaten) -> Eaten:
        """Meals with times from the beginning of the warm-up."""
        return dataclasses.replace(meals, t_min=meals.t_min + self._warm_up_min) if self._warm_up_min else meals


def _for_people(meals: Eaten, people: int) -> Eaten:
    """Meals of all ``(meals,)`` repeated for each person ``(meals, people)``."""
    repeated: Eaten = jax.tree.map(lambda part: np.repeat(np.asarray(part, float)[:, None], people, axis=1), meals)
    return repeated


class _AtSamples:
    """Carbohydrate of meals ``(meals, people)`` at the samples in which they begin."""

    def __init__(self, meals: Eaten, grid: SampleGrid) -> None:
        self._number = np.floor(np.asarray(meals.t_min) / grid.sample_time_min).astype(np.intp)
        self._carbs_g = np.asarray(meals.carbs_g)
        self._first, self._last = self._number.min(axis=1), self._number.max(axis=1)

    def of(self, piece: slice) -> Sparse:
        """Carbohydrate at the samples of a piece, ``(samples, people)``."""
        near = (self._last >= piece.start) & (self._first < piece.stop)
        number, samples = self._number[near] - piece.start, piece.stop - piece.start
        which, person = np.nonzero((number >= 0) & (number < samples))
        carbs_g = self._carbs_g[near][which, person]
        return Sparse((samples, number.shape[1]), number[which, person], person, carbs_g)
