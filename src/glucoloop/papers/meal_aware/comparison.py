"""Verdict on each claim, and the numbers of every controller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop.papers.meal_aware.claims import CLAIMS, Claim, Runs
from glucoloop.papers.meal_aware.experiments import ComparisonRuns
from glucoloop.papers.meal_aware.mismatches import Mismatch
from glucoloop.papers.meal_aware.situations import OURS

SHARES: Final = {"p5": 5.0, "median": 50.0, "p95": 95.0}
"""Percentiles that are reported, in percent of the runs."""


@dataclass(frozen=True)
class Verdict:
    """A claim with its result."""

    claim: Claim
    found: Mapping[str, float]
    """Number found for each controller."""
    bound: float
    runs: str
    """Runs from which the numbers come, in words."""
    of: str = OURS
    """The controller that the claim is about."""

    @property
    def ours(self) -> float:
        """Number of the controller that the claim is about."""
        return self.found[self.of]

    @property
    def holds(self) -> bool:
        """Whether the bound is kept; NaN never keeps it."""
        if not (math.isfinite(self.ours) and math.isfinite(self.bound)):
            return False
        return self.ours >= self.bound if self.claim.at_least else self.ours <= self.bound


def verdicts(study: ComparisonRuns) -> list[Verdict]:
    """Result of each claim about a situation that was run."""
    found = []
    for claim in CLAIMS:
        if not all(name in study.runs for name in claim.sources):
            continue
        sources = [study.runs[name] for name in claim.sources]
        of_each = {name: claim.found(*(source[name] for source in sources)) for name in sources[0]}
        bound = of_each.get(claim.bound, math.nan) if isinstance(claim.bound, str) else claim.bound
        runs = f"one run, as of seed {study.asked.seed}" if claim.quiet else runs_told(study, *claim.sources)
        found.append(Verdict(claim=claim, found=of_each, bound=bound, runs=runs, of=study.ours))
    return found


def runs_told(study: ComparisonRuns, *names: str) -> str:
    """Runs from which the numbers of situations come, in words."""
    rows = [row for row in study.rows if row.name in names]
    if rows:
        told = dict.fromkeys(_runs_of_row(study, row) for row in rows)
        return f"{', '.join(told)}{f'; {len(rows)} situations' if len(rows) > 1 else ''}"
    asked = study.asked
    runs = next(one.runs for one in study.situations if one.name == names[0])
    if runs == "people":
        last = asked.people - 1
        return f"people 0 to {last} of seed {asked.seed}" if last else f"person 0 of seed {asked.seed}"
    if runs == "seeds":
        seeds = asked.sensor_seeds
        return f"seeds {seeds[0]} to {seeds[-1]}" if asked.seeds > 1 else f"seed {seeds[0]}"
    return "one run"


def _runs_of_row(study: ComparisonRuns, row: Mismatch) -> str:
    runs, seed = row.runs_of(study.asked), study.asked.seed
    if row.people != "nominal":
        whose = "" if row.people == "parker2000" else " at corners"
        return f"{runs} people{whose} of seed {seed}"
    return "one run" if runs == 1 else f"{runs} runs of seed {seed}"


def spread(runs: Runs) -> dict[str, dict[str, float]]:
    """Percentiles of each measure over the runs, by measure and by name in `SHARES`."""
    return {
        measure: {name: float(np.percentile(values, share)) for name, share in SHARES.items()}
        for measure, values in runs.numbers.items()
    }


def distances(study: ComparisonRuns, situation: str) -> dict[str, dict[str, float]]:
    """Excess of the largest deviation over the bound, by controller; empty where no bound is known.

    It is that of `bounds.distance_to_bound` for each run; percentiles of it are reported.
    """
    bound = study.bounds.get(situation)
    if bound is None:
        return {}
    return {
        name: {key: value - bound.bound for key, value in spread(runs)["deviation_mg_dl"].items()}
        for name, runs in study.runs[situation].items()
    }
