"""The integrator that suits a patient, for one person and for many."""

from __future__ import annotations

from typing import Any, Protocol

from glucoloop.arguments import is_traced
from glucoloop.native.targets import FUSED
from glucoloop.patients.protocol import Patient
from glucoloop.simulation.adaptive import Adaptive
from glucoloop.simulation.explicit import Explicit, ExplicitPeople
from glucoloop.simulation.exponential import Exponential
from glucoloop.simulation.people_plant import PeoplePlant
from glucoloop.simulation.plant import SampleGrid, SteppingIntegrator
from glucoloop.simulation.user_objects import goes_fast


def default_integrator(patient: Patient, *, minute_inputs: bool = False) -> SteppingIntegrator:
    """The exponential integrator if the patient has its parts and makes nothing of the time, otherwise the explicit.

    With inputs that are held over minutes, exercise or what a rhythm changes, it is always an explicit one. A patient
    that JAX traces has no rates from which the steps of the explicit one follow, and gets the adaptive one.
    """
    if goes_fast(patient) and not minute_inputs:
        return Exponential()
    return Adaptive() if is_traced(patient) else Explicit()


class PlantsOfPeople(Protocol):
    """Plants of people of one kind, of whom only what varies is carried."""

    single: Any
    """Plant of the nominal patient."""
    step_min: float
    substeps: int
    """Steps of a sample."""

    varies: list[bool]
    """Whether each leaf of a plant differs between people."""

    def of(self, patient: Any) -> Any:
        """Plants of people, numbers trailing."""


def plants_of_people(
    nominal: Patient,
    varied: Patient,
    grid: SampleGrid,
    substeps: int | None = None,
    products: str = FUSED,
    *,
    minute_inputs: bool = False,
) -> PlantsOfPeople:
    """Plants by the integrator that `default_integrator` chooses."""
    if goes_fast(nominal) and not minute_inputs:
        return PeoplePlant(nominal, varied, grid, substeps, products)  # type: ignore[arg-type]  # by goes_fast
    return ExplicitPeople(nominal, varied, grid, substeps)
