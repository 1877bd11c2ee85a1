"""Rank of the printed tunings among all others.

The paper says that its tunings give the least sum of squared errors subject to the constraints and to no oscillation.
In these loops the sum keeps falling with more moves and a faster reference, up to where the loop oscillates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from glucoloop.control import MPCTuning, StateTuning
from glucoloop.control.parker1999 import PARKER_1999
from glucoloop.experiments.case import usual_case
from glucoloop.experiments.situation import Situation
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients import Patient
from glucoloop.patients.capabilities import process_noise
from glucoloop.tuning.designers import designer, uses_reference_filter
from glucoloop.tuning.grid import parse_numbers, tuning_grid
from glucoloop.tuning.search import Progress, search
from glucoloop.tuning.surface import TuningRank, TuningSurface

MOVE_HORIZONS: Final = range(1, 5)
PREDICTION_HORIZONS: Final = range(1, 15)
REFERENCE_FILTERS: Final = {"mpc-se": ".3:.8:.05", "nlqdmc-se": ".3:.5:.1,.57,.7,.8"}
"""Values of phi_r that are tried, the printed ones among them; about half as many for NLQDMC/SE, whose loops take a
hundred times as long.
"""


def printed_tuning(operating_point: str, controller: str, *, noisy: bool = False) -> MPCTuning:
    """The tuning that the paper prints for one of its controllers.

    Raises
    ------
    ValueError
        For an unknown controller or operating point.
    """
    uses_reference_filter(controller)
    if (operating_point, noisy) not in PARKER_1999:
        known = ", ".join(sorted({point for point, _ in PARKER_1999}))
        raise ValueError(f"the paper's tunings are not known at {operating_point!r}; the known ones are: {known}")
    paper = PARKER_1999[operating_point, noisy]
    return {"mpc": paper.mpc, "mpc-se": paper.mpc_se, "nlqdmc-se": paper.nlqdmc_se}[controller]


def usual_tuning(situation: Situation, controller: str) -> MPCTuning:
    """The tuning of a controller that is usual in a situation; for the patient of 1999 it is the printed one.

    Raises
    ------
    ValueError
        For a controller that cannot be tuned.
    """
    kind = StateTuning if uses_reference_filter(controller) else MPCTuning
    settings: Mapping[str, Any] = usual_case(controller, situation).tuning
    return kind(**{field.name: settings[field.name] for field in dataclasses.fields(kind)})


def paper_tuning_surface(
    patient: Patient,
    operating_point: str,
    controller: str,
    *,
    model: StepResponseModel | None = None,
    progress: Progress | None = None,
) -> TuningSurface:
    """Search m from 1 to 4, p from m to 14 and phi_r from .3 to .8, without noise.

    Parameters
    ----------
    patient : Patient
    operating_point : {"setpoint-81", "nominal-22", "fasting-81"}
    controller : {"mpc", "mpc-se", "nlqdmc-se"}
    model : StepResponseModel, optional
        Model of linear MPC; identified from a noise-free record by default.
    progress : callable, optional
        Callback as in `search`.
    """
    printed = printed_tuning(operating_point, controller)
    filters = parse_numbers(REFERENCE_FILTERS[controller]) if uses_reference_filter(controller) else None
    grid = tuning_grid(
        MOVE_HORIZONS,
        PREDICTION_HORIZONS,
        output_weights=[printed.output_weight],
        move_weights=[printed.move_weight],
        reference_filters=filters,
        reference_start=getattr(printed, "reference_start", 1),
    )
    noise = process_noise(patient, *PARKER_1999[operating_point, False].noise)
    design = designer(controller, patient, model=model, process_noise=noise)
    points = grid if printed in grid else [*grid, printed]
    return search(patient, design, points, name=controller, progress=progress)


def paper_tuning_rank(
    patient: Patient,
    operating_point: str,
    controller: str,
    *,
    model: StepResponseModel | None = None,
    progress: Progress | None = None,
) -> TuningRank:
    """Rank and sum of squared errors of the printed tuning on that surface; arguments as there."""
    surface = paper_tuning_surface(patient, operating_point, controller, model=model, progress=progress)
    return surface.rank_of(printed_tuning(operating_point, controller))
