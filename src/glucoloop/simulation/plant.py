"""Protocols of an integrator in the closed loop."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop.control.design_case import check_sample_time
from glucoloop.meals.absorption import Absorption
from glucoloop.meals.moments import points_of_sample
from glucoloop.patients.capabilities import paced
from glucoloop.patients.protocol import Inputs, Patient, inputs_of
from glucoloop.units import MIN_PER_DAY


@dataclass(frozen=True)
class SampleGrid:
    """Samples of the loop, and the fine grid of about one minute on which glucose is recorded between them."""

    sample_time_min: float
    samples: int
    start_min: float = 0.0
    """Time of day at the start, in minutes after midnight."""
    warm_up: int = 0
    """Samples before the start, which are simulated and not counted."""

    def __post_init__(self) -> None:
        check_sample_time(self.sample_time_min)

    @property
    def whole(self) -> SampleGrid:
        """The grid from the beginning of the warm-up on, which is the time 0 of a loop."""
        if not self.warm_up:
            return self
        earlier = (self.start_min - self.warm_up_min) % MIN_PER_DAY
        return dataclasses.replace(self, samples=self.warm_up + self.samples, start_min=earlier, warm_up=0)

    @property
    def warm_up_min(self) -> float:
        """Length of the warm-up."""
        return self.warm_up * self.sample_time_min

    @property
    def inside_min(self) -> npt.NDArray[np.float64]:
        """Moments of the fine grid within a sample, its end included, counted from its start."""
        parts = points_of_sample(self.sample_time_min)
        return self.sample_time_min * np.arange(1, parts + 1, dtype=np.float64) / parts

    @property
    def t_min(self) -> npt.NDArray[np.float64]:
        """Time of each sample `(samples,)`."""
        return self.sample_time_min * np.arange(self.samples, dtype=np.float64)

    @property
    def fine_t_min(self) -> npt.NDArray[np.float64]:
        """The whole fine grid, from 0 to the horizon."""
        return np.concatenate([[0.0], (self.t_min[:, None] + self.inside_min).ravel()])


@pytree
class MinuteInputs:
    """Inputs that are held constant from one moment of the fine grid to the next, ``(points, ...)`` of a sample each.

    What is None is not there, and no program knows of it.
    """

    exercise_pct: jax.Array | npt.NDArray[np.float64] | None = None
    """Mean intensity of exercise."""
    sensitivity: jax.Array | npt.NDArray[np.float64] | None = None
    """Factor on the constants that are a patient's sensitivity to insulin."""
    production_mg_kg_min: jax.Array | npt.NDArray[np.float64] | None = None
    """Production of glucose that is added to a patient's own."""
    appearance_mg_min: jax.Array | npt.NDArray[np.float64] | None = None
    """Appearance of glucose that is added to that of the meals, and may be below 0."""
    return_mg_min: jax.Array | npt.NDArray[np.float64] | None = None
    """Appearance less by each mg/dl of glucose at the beginning of the sample, where there is an appearance."""
    glucagon_ug_min: jax.Array | npt.NDArray[np.float64] | None = None
    """Infusion of glucagon, which the loop gives."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs that are there."""
        return tuple(name for name, value in vars(self).items() if value is not None)

    def at_glucose(self, glucose_mg_dl: jax.Array) -> MinuteInputs:
        """The inputs of a sample that begins at a glucose."""
        if self.return_mg_min is None:
            return self
        appearance = jnp.asarray(self.appearance_mg_min) - self.return_mg_min * glucose_mg_dl
        return dataclasses.replace(self, appearance_mg_min=appearance, return_mg_min=None)

    def inputs(self, insulin_mU_min: jax.Array, meal_mg_min: jax.Array) -> Inputs:
        """Inputs of a patient, of those at one moment."""
        if self.appearance_mg_min is not None:
            meal_mg_min = meal_mg_min + self.appearance_mg_min
        return inputs_of(insulin_mU_min, meal_mg_min, self.exercise_pct, self.glucagon_ug_min)  # type: ignore[arg-type]

    def of(self, patient: Patient) -> Patient:
        """The patient as it is at one moment."""
        return paced(patient, self.sensitivity, self.production_mg_kg_min)  # type: ignore[arg-type]


NO_MINUTE_INPUTS: Final = MinuteInputs()


@pytree
class Exogenous:
    """Inputs of a patient in one sample besides insulin; in several with an axis of samples first."""

    t_min: jax.Array
    """Time since the start, at the sample."""
    moments: jax.Array | None = None
    """(steps, 3, ...) Legendre moments of the appearance of meals in each step; None where the plant has the meals."""
    minute_inputs: MinuteInputs = NO_MINUTE_INPUTS
    """Exercise, and what a rhythm changes."""


class Plant(Protocol):
    """A patient prepared to be advanced by whole samples; a pytree."""

    @property
    def patient(self) -> Patient:
        """Patient that the plant advances."""

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array, exogenous: Exogenous) -> tuple[jax.Array, jax.Array]:
        """State after one sample, and glucose on the fine grid inside it."""


class Integrator(Protocol):
    """Protocol of an integrator, which makes a plant from a patient."""

    def prepare(self, patient: Patient, absorption: Absorption, grid: SampleGrid) -> tuple[Plant, Exogenous]:
        """The plant, and its exogenous inputs with one entry per sample on the leading axis."""


class SteppingIntegrator(Integrator, Protocol):
    """An integrator that can also advance sample by sample, with meals that become known on the way."""

    def at_sample(
        self, plant: Any, absorption: Absorption, grid: SampleGrid, index: jax.Array
    ) -> tuple[Any, Exogenous, Any]:
        """The plant with other meals than it was made for, its inputs of one sample, and the gut after; traceable."""
