"""Inputs that are held over each minute of a run: exercise, and what a rhythm changes in a patient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from glucoloop.exercise import Bouts, bouts_of_one, mean_intensity_pct, refuse_exercise
from glucoloop.meals.scenario import Scenario
from glucoloop.patients.capabilities import declared_by
from glucoloop.patients.protocol import Patient
from glucoloop.rhythms.protocol import Rhythm, changes_of
from glucoloop.simulation.plant import Held, SampleGrid


def held_of_people(
    grid: SampleGrid, bouts: Bouts | None, rhythms: Sequence[Rhythm], seed: int, person: npt.ArrayLike
) -> Held:
    """Inputs ``(samples, points, people)`` of people from their bouts and their rhythms."""
    held, points = held_between(grid.fine_t_min, bouts, rhythms, seed, person, grid.start_min), grid.inside_min.size
    return Held(**{name: getattr(held, name).reshape(grid.samples, points, -1) for name in held.names})


def held_between(
    edges_min: npt.NDArray[np.float64],
    bouts: Bouts | None,
    rhythms: Sequence[Rhythm],
    seed: int,
    person: npt.ArrayLike,
    clock_min: float,
) -> Held:
    """Inputs ``(n, people)`` between consecutive times ``(n + 1,)`` of a run that starts at a time of day."""
    if not rhythms and bouts is None:
        return Held()
    changes = changes_of(rhythms, clock_min + (edges_min[:-1] + edges_min[1:]) / 2.0, seed, person)
    return Held(exercise_pct=None if bouts is None else mean_intensity_pct(bouts, edges_min), **vars(changes))


def held_of(patient: Patient, scenario: Scenario, grid: SampleGrid) -> Held:
    """Inputs ``(samples, points)`` of a scenario on a grid that begins with its warm-up.

    Refused where the patient does not take them.
    """
    bouts = bouts_of_one(scenario.exercise).later(scenario.warm_up_min) if scenario.exercise else None
    held = held_of_people(grid, bouts, scenario.rhythms, scenario.rhythm_seed, [scenario.rhythm_person])
    refuse_held(patient, held)
    return Held(**{name: getattr(held, name)[..., 0] for name in held.names})


def refuse_held(patient: Any, held: Held, called: str = "") -> None:
    """Refuse inputs that a patient does not take; a sentence has the name by which the patient was asked for."""
    if held.exercise_pct is not None:
        refuse_exercise(patient, called)
    if held.sensitivity is not None:
        declared_by(patient, "insulin_sensitivity", called)
    if held.production_mg_kg_min is not None:
        declared_by(patient, "glucose_production", called)
