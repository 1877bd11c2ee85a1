"""Protocols of an integrator in the closed loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import jax
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop.control.tuning import check_sample_time
from glucoloop.meals.absorption import Absorption
from glucoloop.meals.moments import points_of_sample
from glucoloop.patients.protocol import Patient


@dataclass(frozen=True)
class SampleGrid:
    """Samples of the loop, and the fine grid of about one minute on which glucose is recorded between them."""

    sample_time_min: float
    samples: int
    start_min: float = 0.0
    """Time of day at the start, in minutes after midnight."""

    def __post_init__(self) -> None:
        check_sample_time(self.sample_time_min)

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
class Exogenous:
    """Inputs of a patient in one sample besides insulin; in several with an axis of samples first."""

    t_min: jax.Array
    """Time since the start, at the sample."""
    moments: jax.Array | None = None
    """(steps, 3, ...) Legendre moments of the appearance of meals in each step; None where the plant has the meals."""


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
