"""Objectives of a tuning: outcomes of the nominal patient under noise, and of people; less is better."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.parts.setting import known_names
from glucoloop.refusal import Refusal
from glucoloop.report.columns import Column, decimals

LOW_MG_DL: Final = 60.0
METRICS: Final = ("undershoot_mg_dl", "minimum_mg_dl", "peak_mg_dl", "insulin_total_variation_mU_min")
"""Metrics that are kept of each subject's run."""


def _objective(name: str, head: str, short: str, digits: int = 1) -> Column:
    return Column(name=name, head=head, short=short, text=decimals(digits))


OBJECTIVES: Final = {
    "undershoot-median": _objective("undershoot_median_mg_dl", "Undershoot, median (mg/dl)", "Undershoot\nmedian"),
    "undershoot-p95": _objective("undershoot_p95_mg_dl", "Undershoot, 95 % (mg/dl)", "Undershoot\n95 %"),
    "peak-median": _objective("peak_median_mg_dl", "Peak, median (mg/dl)", "Peak\nmedian"),
    "peak-p95": _objective("peak_p95_mg_dl", "Peak, 95 % (mg/dl)", "Peak\n95 %"),
    "people-undershoot-p95": _objective(
        "people_undershoot_p95_mg_dl", "Undershoot of people, 95 % (mg/dl)", "People's under-\nshoot, 95 %"
    ),
    "people-peak-p95": _objective("people_peak_p95_mg_dl", "Peak of people, 95 % (mg/dl)", "People's\npeak, 95 %"),
    "people-below-60": _objective("people_below_60", "People below 60 mg/dl", "People\n< 60", digits=0),
    "total-variation": _objective(
        "total_variation_mU_min", "Total variation of insulin, median (mU/min)", "Travel\nmU/min", digits=0
    ),
}
"""Objectives by the names that users write; they are about the nominal patient under noise unless it says people."""

Scores = Mapping[str, float]
"""The objectives of a controller by the names of their columns; NaN where a run had no finite number."""
NO_SCORES: Final[Scores] = {of.name: float("nan") for of in OBJECTIVES.values()}


def objective(name: str) -> Column:
    """An objective by the name that users write; Refusal for an unknown one."""
    if name not in OBJECTIVES:
        raise Refusal(f"unknown objective {name!r}; {known_names(name, OBJECTIVES)}")
    return OBJECTIVES[name]


def scores(metrics: Mapping[str, npt.NDArray[Any]], people: int) -> Scores:
    """The objectives from values ``(subjects,)`` of each of `METRICS`; 95th percentiles are interpolated.

    The first `people` of the subjects are people, and the others are the nominal patient under noise.
    """
    undershoot, peak = metrics["undershoot_mg_dl"], metrics["peak_mg_dl"]
    lowest, variation = metrics["minimum_mg_dl"], metrics["insulin_total_variation_mU_min"]
    of_people, nominal = slice(None, people), slice(people, None)
    finite = bool(np.isfinite(lowest[of_people]).all())
    return {
        "undershoot_median_mg_dl": float(np.median(undershoot[nominal])),
        "undershoot_p95_mg_dl": float(np.quantile(undershoot[nominal], 0.95)),
        "peak_median_mg_dl": float(np.median(peak[nominal])),
        "peak_p95_mg_dl": float(np.quantile(peak[nominal], 0.95)),
        "people_undershoot_p95_mg_dl": float(np.quantile(undershoot[of_people], 0.95)),
        "people_peak_p95_mg_dl": float(np.quantile(peak[of_people], 0.95)),
        "people_below_60": float((lowest[of_people] < LOW_MG_DL).sum()) if finite else float("nan"),
        "total_variation_mU_min": float(np.median(variation[nominal])),
    }
