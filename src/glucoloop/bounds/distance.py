"""Distance of a controller from the bound of its situation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jax.typing import ArrayLike

from glucoloop.bounds.optimal_doses import OptimalDoses, optimal_doses
from glucoloop.meals import Scenario
from glucoloop.patients.protocol import SemilinearPatient
from glucoloop.pumps.limits import DoseLimits
from glucoloop.refusal import Refusal


@dataclass(frozen=True)
class Distance:
    """The largest deviation of a run, and the part of it that no controller could have avoided."""

    deviation_mg_dl: float
    """Largest deviation of the run from its setpoint, to either side."""
    bound_mg_dl: float
    distance_mg_dl: float
    """Part of the deviation that is above the bound."""


def distance_to_bound(glucose_mg_dl: ArrayLike, bound: OptimalDoses) -> Distance:
    """Distance of one person's run to the bound of the same situation.

    Parameters
    ----------
    glucose_mg_dl : (points,) array
        Glucose free of noise, on the grid of one minute.
    bound : OptimalDoses
        Bound for the objective ``deviation``.

    Raises
    ------
    ValueError
        For a bound of something else, or a run of another length.
    """
    glucose = np.asarray(glucose_mg_dl, float)
    if bound.objective != "deviation":
        raise Refusal(f"the bound is of the objective {bound.objective!r}; work it out for 'deviation'")
    if glucose.shape != bound.glucose_mg_dl.shape:
        raise Refusal(
            f"the run has glucose of shape {glucose.shape}, the bound {bound.glucose_mg_dl.shape}; "
            "give one person's run of the same situation"
        )
    deviation = float(np.abs(glucose - bound.setpoint_mg_dl).max())
    return Distance(deviation_mg_dl=deviation, bound_mg_dl=bound.bound, distance_mg_dl=deviation - bound.bound)


def bound_of_situation(
    patient: SemilinearPatient,
    scenario: Scenario,
    pump_limits: DoseLimits,
    *,
    dead_time_min: float = 0.0,
    sample_time_min: float = 5.0,
) -> OptimalDoses:
    """The bound that holds for every controller of a situation, however it learns of meals.

    Announced meals are known at the sample before they begin. Other meals are known a dead time after their start, at
    the first reading that they change; with sensor noise no controller knows of them so early.

    Parameters
    ----------
    patient, scenario, pump_limits
        As for `optimal_doses`.
    dead_time_min : float
        Dead time of the readings.
    sample_time_min : float
    """
    known_after_min = dead_time_min
    if scenario.announced and scenario.meals:
        samples = [math.floor(meal.t_min / sample_time_min) * sample_time_min - meal.t_min for meal in scenario.meals]
        known_after_min = min(samples)
    return optimal_doses(
        patient, scenario, pump_limits, known_after_min=known_after_min, sample_time_min=sample_time_min
    )
