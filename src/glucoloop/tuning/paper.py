"""Rank of the printed tunings among all others.

The paper says that its tunings give the least sum of squared errors subject to the constraints and to no oscillation.
In these loops the sum keeps falling with more moves and a faster reference, up to where the loop oscillates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from glucoloop.control import MPCTuning
from glucoloop.models.step_response import StepResponseModel
from glucoloop.situations.case import usual_case
from glucoloop.situations.situation import Situation, usual_situation
from glucoloop.tuning.designers import designer, kind_of_tuning, usual_filters
from glucoloop.tuning.grid import parse_numbers, tuning_grid
from glucoloop.tuning.search import Progress, search
from glucoloop.tuning.surface import TuningSurface

MOVE_HORIZONS: Final = range(1, 5)
PREDICTION_HORIZONS: Final = range(1, 15)


def usual_tuning(situation: Situation, controller: str) -> MPCTuning:
    """Tuning of a controller that is usual in a situation; for the patient of 1999 it is the printed one."""
    kind = kind_of_tuning(controller)
    settings: Mapping[str, Any] = usual_case(controller, situation).tuning
    return kind(**{field.name: settings[field.name] for field in dataclasses.fields(kind)})


def printed_tuning(operating_point: str, controller: str) -> MPCTuning:
    """Tuning that the paper prints for one of its controllers, without noise."""
    return usual_tuning(_situation(operating_point), controller)


def _situation(operating_point: str) -> Situation:
    return usual_situation(operating_point=operating_point)


def paper_tuning_surface(
    operating_point: str,
    controller: str,
    *,
    model: StepResponseModel | None = None,
    progress: Progress | None = None,
) -> TuningSurface:
    """Search m from 1 to 4, p from m to 14 and phi_r from .3 to .8, without noise."""
    situation, printed = _situation(operating_point), printed_tuning(operating_point, controller)
    case = usual_case(controller, situation)
    filters = usual_filters(controller, case.tuning)
    grid = tuning_grid(
        MOVE_HORIZONS,
        PREDICTION_HORIZONS,
        output_weights=[printed.output_weight],
        move_weights=[printed.move_weight],
        reference_filters=None if filters is None else parse_numbers(filters),
        reference_start=getattr(printed, "reference_start", 1),
    )
    design = designer(situation, case, model)
    points = grid if printed in grid else [*grid, printed]
    return search(situation, design, points, name=controller, progress=progress)
