"""Claims about the meal-aware controller: each is a number of its runs, with a bound."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from glucoloop.papers.entries import ComparedEntry, PaperEntry, Reproduced, compared, read_entries
from glucoloop.papers.meal_aware.measures import Floats, Runs
from glucoloop.papers.meal_aware.situations import ALL_SITUATIONS, Extent

AllRuns = Mapping[str, Mapping[str, Runs]]
"""Runs by the name of a situation, and by controller."""

SHARES: Final = {"p5": 5.0, "median": 50.0, "p95": 95.0}
"""Percentiles that are reported, in percent of the runs."""

OVER_RUNS: Final[Mapping[str, Callable[[Floats], float]]] = {
    "median": np.median,
    "95 %": lambda values: float(np.percentile(values, 95.0)),
    "greatest": np.max,
    "least": np.min,
    "size of the mean": lambda values: abs(float(np.mean(values))),
    "number below 60": lambda values: float(np.sum(values < 60.0)),
}
"""Functions of the values of a measure over the runs, which a claim is about."""
MOST_ADDED: Final = "most above the first situation"
"""The most by which a run of another situation exceeds the same run of the first one."""


@dataclass(frozen=True, kw_only=True)
class Claim(PaperEntry):
    """A claim about the meal-aware controller; what is printed of it is its bound.

    The name of a controller as the bound stands for the number of that controller in the same runs.
    """

    kind: Literal["value", "at-most", "at-least"] = "at-most"
    situation: str
    """Name of a situation, or of a group of situations."""
    measure: str
    over_runs: str
    """Name in `OVER_RUNS`, or `MOST_ADDED`."""
    rows: tuple[str, ...] = ()
    """Names of situations of the group, from whose runs the number comes; for several, that of the worst one."""

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the situations whose runs the claim needs."""
        return self.rows or (self.situation,)

    def found(self, runs: Sequence[Runs]) -> Reproduced:
        """The number that the bound is about, from the runs of a controller in each of the situations."""
        first, *others = each = [of.numbers[self.measure] for of in runs]
        if self.over_runs == MOST_ADDED:
            return Reproduced(max(float(np.max(values - first)) for values in others))
        worst = min if self.kind == "at-least" else max
        return Reproduced(worst(float(OVER_RUNS[self.over_runs](values)) for values in each))

    def runs_told(self, extent: Extent) -> str:
        """Runs from which the number comes, in words."""
        if self.measure.startswith("quiet"):
            return f"one run, as of seed {extent.seed}"
        many = [row for row in ALL_SITUATIONS if row.name in self.sources]
        told = ", ".join(dict.fromkeys(row.runs_told(extent) for row in many))
        return f"{told}; {len(many)} situations" if len(many) > 1 else told


CLAIMS: Final = read_entries(__package__, "claims.toml", Claim)


def judged(runs: AllRuns) -> list[ComparedEntry[Claim]]:
    """Each claim about situations that were run, beside what was found for each controller."""
    rows = []
    for claim in CLAIMS:
        if not set(claim.sources) <= runs.keys():
            continue
        of_each = [runs[name] for name in claim.sources]
        found = {controller: {claim.id: claim.found([of[controller] for of in of_each])} for controller in of_each[0]}
        beside = found.get(str(claim.printed), {}).get(claim.id, Reproduced(math.nan))
        bound = beside.median if isinstance(claim.printed, str) else claim.printed
        rows += compared([replace(claim, printed=bound)], found)
    return rows


def spread(values: Floats) -> dict[str, float]:
    """Percentiles of a measure over the runs, by their names in `SHARES`."""
    return {name: float(np.percentile(values, share)) for name, share in SHARES.items()}
