"""Objectives of a tuning: outcomes of the nominal patient under noise, and of people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.parts.setting import known_names
from glucoloop.refusal import Refusal

Floats = npt.NDArray[np.float64]

LOW_MG_DL: Final = 60.0
METRICS: Final = ("undershoot_mg_dl", "minimum_mg_dl", "peak_mg_dl", "insulin_total_variation_mU_min")
"""Metrics that are kept of each subject's run."""


@dataclass(frozen=True)
class Objective:
    """One number of a tuning; less is better."""

    name: str
    """Name of the objective as the user writes it."""
    column: str
    """Name of the objective as a column of tables."""
    label: str
    unit: str


OBJECTIVES: Final[dict[str, Objective]] = {
    of.name: of
    for of in (
        Objective("undershoot-median", "undershoot_median_mg_dl", "Undershoot, median", "mg/dl"),
        Objective("undershoot-p95", "undershoot_p95_mg_dl", "Undershoot, 95 %", "mg/dl"),
        Objective("peak-median", "peak_median_mg_dl", "Peak, median", "mg/dl"),
        Objective("peak-p95", "peak_p95_mg_dl", "Peak, 95 %", "mg/dl"),
        Objective("people-undershoot-p95", "people_undershoot_p95_mg_dl", "Undershoot of people, 95 %", "mg/dl"),
        Objective("people-peak-p95", "people_peak_p95_mg_dl", "Peak of people, 95 %", "mg/dl"),
        Objective("people-below-60", "people_below_60", "People below 60 mg/dl", ""),
        Objective("total-variation", "total_variation_mU_min", "Total variation of insulin, median", "mU/min"),
    )
}
"""Objectives by name; they are about the nominal patient under noise unless their name says people."""


def objective(name: str) -> Objective:
    """An objective by name.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    if name not in OBJECTIVES:
        raise Refusal(f"unknown objective {name!r}; {known_names(name, OBJECTIVES)}")
    return OBJECTIVES[name]


def scores(metrics: Mapping[str, npt.NDArray[Any]], people: int) -> dict[str, float]:
    """The objectives of a controller, by name.

    Parameters
    ----------
    metrics : mapping
        Values ``(subjects,)`` of each of `METRICS`.
    people : int
        Number of subjects that are people, the first ones. The others are the nominal patient under noise.

    Returns
    -------
    dict
        The 95th percentiles are interpolated between order statistics; not a number where a run was not.
    """
    undershoot, peak = metrics["undershoot_mg_dl"], metrics["peak_mg_dl"]
    lowest, variation = metrics["minimum_mg_dl"], metrics["insulin_total_variation_mU_min"]
    of_people, nominal = slice(None, people), slice(people, None)
    finite = bool(np.isfinite(lowest[of_people]).all())
    return {
        "undershoot-median": float(np.median(undershoot[nominal])),
        "undershoot-p95": float(np.quantile(undershoot[nominal], 0.95)),
        "peak-median": float(np.median(peak[nominal])),
        "peak-p95": float(np.quantile(peak[nominal], 0.95)),
        "people-undershoot-p95": float(np.quantile(undershoot[of_people], 0.95)),
        "people-peak-p95": float(np.quantile(peak[of_people], 0.95)),
        "people-below-60": float((lowest[of_people] < LOW_MG_DL).sum()) if finite else float("nan"),
        "total-variation": float(np.median(variation[nominal])),
    }
