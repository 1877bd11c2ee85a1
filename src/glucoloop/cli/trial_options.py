"""The options of a trial, and of the studies that are trials with further keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from glucoloop.cli.options import CASE, MMOL, OUTPUT, SITUATION, Option, among, options_of, reworded, without
from glucoloop.config.key import text_of
from glucoloop.config.options.trial import (
    CONTROLLERS_PANEL,
    MEALS_PANEL,
    PEOPLE_PANEL,
    SITUATION_KEYS,
    WORK_PANEL,
    TrialKeys,
)

CASES: Final = Option(
    "cases",
    "--case",
    list[str],
    "A controller with settings of its own, like 'careful: mpc, move_weight=1'; repeat it for more.",
    CONTROLLERS_PANEL,
    metavar="CASE",
)
WORKERS: Final = Option(
    "workers",
    "--workers",
    int,
    "Threads that compute; with --dask local, processes.",
    WORK_PANEL,
    metavar="N",
    default="one a core",
)
DASK: Final = Option(
    "dask",
    "--dask",
    str,
    "Compute on a Dask cluster: the address of its scheduler, like tcp://10.0.0.1:8786, or local.",
    WORK_PANEL,
    metavar="ADDRESS",
)
_OWN: Final = options_of(TrialKeys)
TRIAL: Final = (
    *(option for option in _OWN if option.panel != WORK_PANEL),
    CASES,
    *reworded(
        (*among(SITUATION, SITUATION_KEYS), *without(CASE, "controller", "model")),
        help={
            "operating_point": "Operating point of the nominal patient, for whom controllers are designed.",
            "setpoint_mg_dl": "Glucose at which all people rest at the start, and the target; that of the operating "
            "point by default.",
            "seed": "The same seed gives the same people, meals and noise.",
        },
        panel={
            **dict.fromkeys(("patient", "setpoint_mg_dl", "seed", "operating_point"), PEOPLE_PANEL),
            **dict.fromkeys(("meal_model", "announce_meals", "carb_error_pct", "carb_bias_pct", "start"), MEALS_PANEL),
        },
    ),
    *(option for option in _OWN if option.panel == WORK_PANEL),
    WORKERS,
    DASK,
    *reworded(
        (*OUTPUT, MMOL),
        help={
            "out": "Folder of the trial; an unfinished trial in it is resumed.",
            "overwrite": "Begin again and replace the trial in the folder.",
            "json": "Print the summary as one JSON object.",
        },
    ),
)


def usual_texts(usual: Mapping[str, Any]) -> dict[str, str | None]:
    """Text of the usual value of each key, for help."""
    return {key: text_of(value) for key, value in usual.items()}
