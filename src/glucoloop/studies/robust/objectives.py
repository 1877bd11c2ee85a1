"""Objectives of a tuning, of which less is better, and selection by them: bounds, the Pareto front, and the choice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.parts.setting import known_names
from glucoloop.refusal import Refusal
from glucoloop.report.columns import Column, decimals
from glucoloop.studies.robust import BOTH

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


@dataclass(frozen=True)
class Bound:
    """A bound on an objective."""

    objective: str
    most: float
    of: str | None = None
    """Controller whose value is the bound, or None for a given number."""

    def violation(self, scores: Any) -> Any:
        """Relative excess of scores, or of columns of them, over the bound; 0 or less where it is kept."""
        return (scores[OBJECTIVES[self.objective].name] - self.most) / max(abs(self.most), 1.0)


def judged(tried: pl.DataFrame, bounds: Sequence[Bound], objectives: Sequence[str], prefer: str = BOTH) -> pl.DataFrame:
    """Tunings that were tried, with columns for those that keep the bounds, those on the front, and the chosen one.

    If none keeps the bounds, the one that exceeds them least is chosen; Refusal if none has a controller.
    """
    values = tried.select(OBJECTIVES[name].name for name in objectives).to_numpy()
    finite = np.isfinite(values).all(axis=1)
    if not finite.any():
        raise Refusal("no tuning of the search has a controller that works; give other ranges")
    over = np.array([bound.violation(tried).to_numpy() for bound in bounds]).reshape(-1, len(tried))
    keeps = finite & np.all(over <= 0.0, axis=0)
    front = np.zeros(len(tried), bool)
    if keeps.any():
        front[keeps] = pareto(values[keeps])
        chosen = np.flatnonzero(front)[choose(values[front], objectives, prefer)]
    else:
        excess = np.maximum(over, 0.0).sum(axis=0)
        chosen = np.argmin(np.where(finite & np.isfinite(excess), excess, np.inf))
    return tried.with_columns(
        pl.Series("keeps_the_bounds", keeps),
        pl.Series("on_the_front", front),
        pl.Series("chosen", np.arange(len(tried)) == chosen),
    )


def pareto(values: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """Whether each row of ``(n, 2)`` is on the Pareto front: no row is better in one column and as good in both."""
    order = np.lexsort((values[:, 1], values[:, 0]))
    front = np.zeros(len(values), bool)
    least, at = np.inf, np.inf
    for place in order:
        first, second = values[place]
        if second < least or (second == least and first == at):
            front[place] = True
            least, at = second, first
    return front


def choose(values: npt.NDArray[np.float64], objectives: Sequence[str], prefer: str) -> int:
    """Index of the row of a front ``(n, 2)`` that is chosen.

    It has the least value of the preferred objective; or, for ``"both"``, it is nearest to the least of both, each
    measured by its range over the front.
    """
    if prefer in objectives:
        first = list(objectives).index(prefer)
        return int(np.lexsort((values[:, 1 - first], values[:, first]))[0])
    least, reach = values.min(axis=0), np.ptp(values, axis=0)
    away = (values - least) / np.where(reach > 0.0, reach, 1.0)
    return int(np.argmin(np.hypot(away[:, 0], away[:, 1])))
