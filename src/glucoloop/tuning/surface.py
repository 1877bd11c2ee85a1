"""Results of a search over tunings."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from glucoloop.control.tuning import MPCTuning, StateTuning
from glucoloop.refusal import Refusal

Floats = npt.NDArray[np.float64]
Truths = npt.NDArray[np.bool_]
Counts = npt.NDArray[np.int64]


@dataclass(frozen=True)
class TuningRank:
    """Rank of one tuning among those of a surface."""

    tuning: MPCTuning
    rank: int | None
    """Rank by the sum of squared errors among the acceptable points, 1 for the minimum; None for a tuning that is not
    acceptable.
    """
    points: int
    """Number of acceptable points."""
    sse: float
    best: MPCTuning | None
    best_sse: float | None
    equal: int = 0
    """Number of other acceptable points with the same sum."""
    label: str = "printed"
    """Kind of tuning: "printed" in the paper, or "usual" for another patient than the paper's."""


@dataclass(frozen=True)
class TuningSurface:
    """Results for each tuning; every array is `(points,)`, a median where there are several seeds."""

    controller: str
    tunings: tuple[MPCTuning, ...]
    refused: tuple[tuple[MPCTuning, str], ...]
    """Tunings for which no controller could be designed, with the reason; they are in no array."""
    seeds: int
    sse: Floats
    """Sum over samples of the squared distance from the setpoint, (mg/dl)^2."""
    undershoot_mg_dl: Floats
    minimum_mg_dl: Floats
    settling_2pct_min: Floats
    settled_2pct: Truths
    """Whether glucose settled within 2 % in more than half of the runs."""
    settling_5pct_min: Floats
    settled_5pct: Truths
    insulin_total_variation_mU_min: Floats
    kept_share: Floats
    """Share of the runs that keep the constraints (17) to (19): rate, magnitude, and glucose above 60 mg/dl."""
    crossings: Counts
    """Crossings of the band around the setpoint, without noise; see `oscillation`."""
    turns: Counts
    """Turns of insulin, without noise."""
    oscillates: Truths

    @property
    def feasible(self) -> Truths:
        """Whether more than half of the runs keep the constraints."""
        return self.kept_share > 0.5

    @property
    def acceptable(self) -> Truths:
        """Whether a tuning keeps the constraints without oscillation."""
        return self.feasible & ~self.oscillates & np.isfinite(self.sse)

    def order(self) -> npt.NDArray[np.intp]:
        """Indices of the points by the sum of squared errors, the acceptable ones first."""
        sse = np.where(np.isfinite(self.sse), self.sse, np.inf)
        return np.lexsort((sse, ~self.acceptable))

    def best_index(self) -> int:
        """The acceptable point with the smallest sum of squared errors; refused if no point is acceptable."""
        first = int(self.order()[0])
        if not self.acceptable[first]:
            raise Refusal(
                "no tuning of the grid keeps the constraints without oscillation; "
                "look farther ahead, plan fewer moves, or give a move weight"
            )
        return first

    def best(self) -> MPCTuning:
        """The acceptable tuning with the smallest sum of squared errors; raises as `best_index`."""
        return self.tunings[self.best_index()]

    def index(self, tuning: MPCTuning) -> int:
        """Index of a tuning of the grid in the arrays."""
        if tuning not in self.tunings:
            raise Refusal(f"the tuning {tuning_text(tuning)} is not a point of the grid; add it to the search")
        return self.tunings.index(tuning)

    def rank_of(self, tuning: MPCTuning, label: str = "printed") -> TuningRank:
        """Rank of a tuning by the sum of squared errors among the acceptable ones; equal sums share a rank."""
        point, acceptable = self.index(tuning), self.acceptable
        better = acceptable & (self.sse < self.sse[point])
        best = self.best_index() if acceptable.any() else None
        return TuningRank(
            tuning=tuning,
            rank=int(better.sum()) + 1 if acceptable[point] else None,
            points=int(acceptable.sum()),
            sse=float(self.sse[point]),
            best=None if best is None else self.tunings[best],
            best_sse=None if best is None else float(self.sse[best]),
            equal=int((acceptable & (self.sse == self.sse[point])).sum()) - 1 if acceptable[point] else 0,
            label=label,
        )

    def only(self, tunings: Collection[MPCTuning]) -> TuningSurface:
        """The same results for some of the tunings, in the order of the surface."""
        selected = np.array([tuning in tunings for tuning in self.tunings], bool)
        return dataclasses.replace(
            self,
            tunings=tuple(tuning for tuning in self.tunings if tuning in tunings),
            refused=tuple(one for one in self.refused if one[0] in tunings),
            **{name: value[selected] for name, value in self._results().items()},
        )

    def _results(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays of the surface by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """The surface as a table: one column for each parameter and each result."""
        names = ["move_horizon", "prediction_horizon", "output_weight", "move_weight"]
        if all(isinstance(tuning, StateTuning) for tuning in self.tunings):
            names.append("reference_filter")
        parameters = {name: np.array([getattr(tuning, name) for tuning in self.tunings]) for name in names}
        return {**parameters, **self._results(), "feasible": self.feasible, "acceptable": self.acceptable}


def tuning_text(tuning: MPCTuning) -> str:
    """A tuning in the paper's notation, (m, p, Γ_y, Γ_u[, φ_r])."""
    values = [tuning.move_horizon, tuning.prediction_horizon, tuning.output_weight, tuning.move_weight]
    if isinstance(tuning, StateTuning):
        values.append(tuning.reference_filter)
    return f"({', '.join(f'{value:.4g}' for value in values)})"
