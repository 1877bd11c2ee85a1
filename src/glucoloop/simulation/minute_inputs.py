"""Inputs that are held over each minute of a run: exercise, and what a rhythm changes in a patient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from glucoloop.meals.scenario import Scenario
from glucoloop.patients.capabilities import declared_by, refuse_glucagon
from glucoloop.patients.protocol import Patient
from glucoloop.physiology.exercise import Bouts, bouts_of_one, mean_intensity_pct, refuse_exercise
from glucoloop.physiology.rhythm import Rhythm, changes_of
from glucoloop.simulation.plant import MinuteInputs, SampleGrid


@dataclass(frozen=True)
class PeopleMinuteInputs:
    """Inputs of people from their bouts, their rhythms and an appearance, made for a piece of a run at a time.

    So memory does not grow with the length of the run.
    """

    grid: SampleGrid
    bouts: Bouts | None
    rhythms: Sequence[Rhythm]
    seed: int
    person: npt.ArrayLike
    appearance_mg_min: npt.NDArray[np.float64] | None = None
    """``(samples, people)`` appearance of glucose beside that of the meals."""
    return_mg_min: npt.NDArray[np.float64] | None = None
    """``(people,)`` appearance less by each mg/dl of glucose at the beginning of a sample."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs that are there."""
        return self.of(slice(0, 1)).names

    def of(self, piece: slice) -> MinuteInputs:
        """Inputs ``(samples, points, people)`` in samples of the run, all by default."""
        start, stop, _ = piece.indices(self.grid.samples)
        points = self.grid.inside_min.size
        appearing = dict[str, npt.NDArray[np.float64]]()
        if self.appearance_mg_min is not None:
            appearing["appearance_mg_min"] = np.repeat(self.appearance_mg_min[start:stop, None], points, axis=1)
        if self.return_mg_min is not None:
            appearing["return_mg_min"] = np.tile(self.return_mg_min, (stop - start, points, 1))
        if not self.rhythms and self.bouts is None:
            return MinuteInputs(**appearing)
        edges_min = self.grid.fine_t_min[start * points : stop * points + 1]
        minute_inputs = minute_inputs_between(
            edges_min, self.bouts, self.rhythms, self.seed, self.person, self.grid.start_min
        )
        return MinuteInputs(
            **{name: getattr(minute_inputs, name).reshape(stop - start, points, -1) for name in minute_inputs.names},
            **appearing,
        )


def minute_inputs_between(
    edges_min: npt.NDArray[np.float64],
    bouts: Bouts | None,
    rhythms: Sequence[Rhythm],
    seed: int,
    person: npt.ArrayLike,
    clock_min: float,
) -> MinuteInputs:
    """Inputs ``(n, people)`` between consecutive times ``(n + 1,)`` of a run that starts at a time of day."""
    if not rhythms and bouts is None:
        return MinuteInputs()
    changes = changes_of(rhythms, clock_min + (edges_min[:-1] + edges_min[1:]) / 2.0, seed, person)
    return MinuteInputs(exercise_pct=None if bouts is None else mean_intensity_pct(bouts, edges_min), **vars(changes))


def minute_inputs_of(patient: Patient, scenario: Scenario, grid: SampleGrid) -> MinuteInputs:
    """Inputs ``(samples, points)`` of a scenario on a grid that begins with its warm-up.

    Refused where the patient does not take them.
    """
    bouts = bouts_of_one(scenario.exercise).later(scenario.warm_up_min) if scenario.exercise else None
    of_person = PeopleMinuteInputs(grid, bouts, scenario.rhythms, scenario.rhythm_seed, [scenario.rhythm_person])
    minute_inputs = of_person.of(slice(None))
    refuse_minute_inputs(patient, minute_inputs)
    return MinuteInputs(**{name: getattr(minute_inputs, name)[..., 0] for name in minute_inputs.names})


def refuse_minute_inputs(patient: Any, minute_inputs: MinuteInputs, called: str = "") -> None:
    """Refuse inputs that a patient does not take; a sentence has the name by which the patient was asked for."""
    if minute_inputs.exercise_pct is not None:
        refuse_exercise(patient, called)
    if minute_inputs.glucagon_ug_min is not None:
        refuse_glucagon(patient, called)
    if minute_inputs.sensitivity is not None:
        declared_by(patient, "insulin_sensitivity", called)
    if minute_inputs.production_mg_kg_min is not None:
        declared_by(patient, "glucose_production", called)
