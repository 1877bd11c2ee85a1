"""Claims about the meal-aware controller: each is a number of its runs, with a bound."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from meal_aware.measures import Floats, Runs
from meal_aware.situations import ALL_SITUATIONS, Extent

AllRuns = Mapping[str, Mapping[str, Runs]]
"""Runs by the name of a situation, and by controller."""

SHARES: Final = {"p5": 5.0, "median": 50.0, "p95": 95.0}
"""Percentiles that are reported, in percent of the runs."""

OVER_RUNS: Final[Mapping[str, Callable[[Floats], float]]] = {
    "median": np.median,
    "95th percentile": lambda values: float(np.percentile(values, 95.0)),
    "greatest": np.max,
    "least": np.min,
    "size of the mean": lambda values: abs(float(np.mean(values))),
    "number below 60": lambda values: float(np.sum(values < 60.0)),
}
"""Functions of the values of a measure over the runs, which a claim is about."""
MAX_ADDED: Final = "most above the first situation"
"""The most by which a run of another situation exceeds the same run of the first one."""


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A claim about the meal-aware controller."""

    id: str
    what: str
    bound: float | str
    """A number; or the name of a controller, for the number of that controller in the same runs."""
    unit: str = ""
    kind: Literal["at-most", "at-least"] = "at-most"
    situation: str
    """Name of a situation, or of a group of situations."""
    measure: str
    over_runs: str
    """Name in `OVER_RUNS`, or `MAX_ADDED`."""
    rows: tuple[str, ...] = ()
    """Names of situations of the group, from whose runs the number comes; for several, that of the worst one."""

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the situations whose runs the claim needs."""
        return self.rows or (self.situation,)

    def number(self, runs: Sequence[Runs]) -> float:
        """The number that the bound is about, from the runs of a controller in each of the situations."""
        first, *others = each = [one.numbers[self.measure] for one in runs]
        if self.over_runs == MAX_ADDED:
            return max(float(np.max(values - first)) for values in others)
        worst = min if self.kind == "at-least" else max
        return worst(float(OVER_RUNS[self.over_runs](values)) for values in each)

    def runs_in_words(self, extent: Extent) -> str:
        """Runs from which the number comes, in words."""
        if self.measure.startswith("quiet"):
            return f"one run, as of seed {extent.seed}"
        rows = [row for row in ALL_SITUATIONS if row.name in self.sources]
        words = ", ".join(dict.fromkeys(row.runs_in_words(extent) for row in rows))
        return f"{words}; {len(rows)} situations" if len(rows) > 1 else words


@dataclass(frozen=True)
class JudgedClaim:
    """A claim beside the number of each controller."""

    claim: Claim
    bound: float
    numbers: Mapping[str, float]

    def holds(self, controller: str) -> bool:
        """Whether a controller keeps the bound, which NaN never does."""
        number = self.numbers[controller]
        return number >= self.bound if self.claim.kind == "at-least" else number <= self.bound


def _read_claims() -> Iterator[Claim]:
    file = Path(__file__).with_name("claims.toml")
    for row in tomllib.loads(file.read_text(encoding="utf-8"))["claim"]:
        yield Claim(**{**row, "rows": tuple(row.get("rows", ()))})


CLAIMS: Final = tuple(_read_claims())


def judged(runs: AllRuns) -> Iterator[JudgedClaim]:
    """Each claim about situations that were run."""
    for claim in CLAIMS:
        if set(claim.sources) <= runs.keys():
            of_each = [runs[name] for name in claim.sources]
            numbers = {controller: claim.number([each[controller] for each in of_each]) for controller in of_each[0]}
            bound = numbers.get(claim.bound, math.nan) if isinstance(claim.bound, str) else claim.bound
            yield JudgedClaim(claim, bound, numbers)


def spread(values: Floats) -> dict[str, float]:
    """Percentiles of a measure over the runs, by their names in `SHARES`."""
    return {name: float(np.percentile(values, share)) for name, share in SHARES.items()}
