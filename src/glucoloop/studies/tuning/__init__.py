"""Search of a grid: every tuning of a controller in one situation, and their order."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Final

from glucoloop.config.key import Key
from glucoloop.config.options.case import OF_OTHERS
from glucoloop.control.catalogue import CONTROLLERS, TUNABLE, setting_names
from glucoloop.parts.guard import GUARD
from glucoloop.studies.study import PlainStudy

MOST_SEEDS: Final = 1000
_grid = functools.partial(Key, panel="Grid")
_range = functools.partial(_grid, metavar="RANGE")


@dataclass(frozen=True, kw_only=True)
class RangeSettings:
    """Range of each parameter that is tuned; None for the usual one."""

    move_horizon: Annotated[str, _range("Numbers of planned moves, m.")] = "1:4"
    prediction_horizon: Annotated[str, _range("Numbers of predicted samples, p; those below m are left out.")] = "1:14"
    reference_filter: Annotated[
        str | None,
        _range(
            "Filters of the reference, φ_r; closer to 1 is slower.",
            told="; ".join(
                f"{entry.name}: {entry.reference_filters}" for entry in CONTROLLERS.values() if entry.reference_filters
            ),
        ),
    ] = None
    output_weight: Annotated[
        str | None, _range("Weights on the error of glucose, Γ_y; only the ratio to Γ_u matters.", told="the paper's")
    ] = None
    move_weight: Annotated[str | None, _range("Weight on each move of insulin, Γ_u.", told="the paper's")] = None


@dataclass(frozen=True, kw_only=True)
class GridSettings:
    """Other keys of a search that a run does not have."""

    seeds: Annotated[
        int | None,
        _grid(
            "Number of runs of each tuning with noise, another sensor or a fault, from --seed on.",
            told="5",
            at_least=1,
            at_most=MOST_SEEDS,
        ),
    ] = None
    top: Annotated[int, _grid("Number of tunings in the table.", at_least=1, at_most=100_000)] = 10


_TUNABLE_SETTINGS: Final = {setting for name in TUNABLE for setting in CONTROLLERS[name].settings()}
_CONTROLLERS: Final = "; ".join(f"{name}: {CONTROLLERS[name].summary}" for name in TUNABLE)

TUNE: Final = PlainStudy(
    name="tune",
    what="a search of a grid",
    help=(
        "Simulate every tuning of a grid with the same patient, meals, sensor and pump; the results are a table and a "
        "picture.\n\n"
        "A tuning is acceptable if it keeps the constraints (change of the rate, rate, glucose above 60 mg/dl) and "
        "does not oscillate. Acceptable tunings are ranked by the sum of squared errors, and the paper's own tuning is "
        "shown with its rank. A range is written 1:4, with both ends included, 2:16:2 or .3:.8:.05, with a step, or "
        "0,1,3. With --noise, results are medians over seeds, and oscillation is judged without noise.\n\n"
        "  glucoloop tune --move-horizon 1:4 --prediction-horizon 2:16 --out surface\n\n"
        "  glucoloop tune --controller mpc-se --reference-filter .3:.8:.1 --top 5\n\n"
        "  glucoloop tune --noise 1.45 --seeds 20 --move-horizon 2 --prediction-horizon 10 --move-weight 0,1,3"
    ),
    module="glucoloop.studies.tuning.study",
    settings=(RangeSettings, GridSettings),
    # a search is for the controller in a sound loop, so without faults and without a guard
    refused=(
        "faults",
        "metrics",
        "guard",
        *GUARD,
        *(setting_names() - _TUNABLE_SETTINGS),
    ),
    words={"help": {"controller": f"{_CONTROLLERS}; {OF_OTHERS}."}},
    summary="tune.json",
)
