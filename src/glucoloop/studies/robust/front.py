"""Selection of tunings: those that keep the bounds, the Pareto front among them, and the chosen one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal
from glucoloop.studies.robust.options import BOTH


@dataclass(frozen=True)
class Bound:
    """A bound on an objective."""

    objective: str
    most: float
    of: str | None = None
    """Controller whose value is the bound, or None for a given number."""

    def violation(self, scores: Mapping[str, float]) -> float:
        """Relative excess of scores over the bound; 0 or less if it is kept."""
        return (scores[self.objective] - self.most) / max(abs(self.most), 1.0)


def keeps(scores: Mapping[str, float], bounds: Sequence[Bound], objectives: Sequence[str]) -> bool:
    """Whether scores keep all bounds, and the objectives are finite."""
    finite = all(np.isfinite(scores[name]) for name in objectives)
    return finite and all(bound.violation(scores) <= 0.0 for bound in bounds)


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

    Parameters
    ----------
    values : (n, 2) array
    objectives : (str, str)
    prefer : str
        One of the objectives, the least of which is chosen; or ``"both"``: the row that is nearest to the least of
        both, each measured by its range over the front.

    Raises
    ------
    ValueError
        For another text.
    """
    if prefer in objectives:
        first = list(objectives).index(prefer)
        return int(np.lexsort((values[:, 1 - first], values[:, first]))[0])
    if prefer != BOTH:
        raise Refusal(f"{prefer!r} cannot be preferred; the known ones are: {', '.join(objectives)}, {BOTH}")
    least, reach = values.min(axis=0), np.ptp(values, axis=0)
    away = (values - least) / np.where(reach > 0.0, reach, 1.0)
    return int(np.argmin(np.hypot(away[:, 0], away[:, 1])))
