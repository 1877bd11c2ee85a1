"""Selection of tunings: those that keep the bounds, the Pareto front among them, and the chosen one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.refusal import Refusal
from glucoloop.studies.robust import BOTH
from glucoloop.studies.robust.objectives import OBJECTIVES


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
