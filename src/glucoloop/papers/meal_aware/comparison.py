"""Claims about the meal-aware controller, each a number with its bound, and the numbers of every controller."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop.papers.meal_aware.experiments import ComparisonRuns, ControllerRuns
from glucoloop.papers.meal_aware.measures import LATE_MIN, MEASURES, NEAR_MG_DL, SWING_MG_DL
from glucoloop.papers.meal_aware.situations import OURS, NamedSituation
from glucoloop.tuning.oscillation import CROSSINGS_PER_MEAL, TURNS_PER_MEAL

SHARES: Final = {"p5": 5.0, "median": 50.0, "p95": 95.0}
"""Percentiles that are reported, in percent of the runs."""

Found = Callable[[ControllerRuns], float]


@dataclass(frozen=True)
class Claim:
    """A claim about the meal-aware controller."""

    id: str
    situation: str
    what: str
    unit: str
    found: Found
    """Function from the loops of a controller to the number that the bound is about."""
    bound: float | str
    """A number, or the name of a controller whose own number from the same runs is the bound."""
    at_least: bool = False
    """Whether the bound is the least value rather than the greatest."""
    digits: int = 2
    quiet: bool = False
    """Whether the claim is about the run without noise, and not about the seeds."""


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


def _percentile(measure: str, share: float) -> Found:
    return lambda loops: float(np.percentile(loops.numbers[measure], share))


def _greatest(measure: str) -> Found:
    return lambda loops: float(loops.numbers[measure].max())


def _median(measure: str) -> Found:
    return _percentile(measure, 50.0)


def _below_60(loops: ControllerRuns) -> float:
    return float((loops.numbers["minimum_mg_dl"] < 60.0).sum())


def _crossings(loops: ControllerRuns) -> float:
    return math.nan if loops.quiet is None else float(loops.quiet.crossings)


def _turns(loops: ControllerRuns) -> float:
    return math.nan if loops.quiet is None else float(loops.quiet.turns)


CLAIMS: Final = (
    Claim("noise-free.undershoot", "noise-free", "undershoot", "mg/dl", _greatest("undershoot_mg_dl"), 2.0),
    Claim("noise-free.peak", "noise-free", "peak above the setpoint", "mg/dl", _greatest("overshoot_mg_dl"), 2.5),
    Claim("noise.undershoot", "noise", "undershoot, median", "mg/dl", _median("undershoot_mg_dl"), 6.0),
    Claim(
        "noise.undershoot-95", "noise", "undershoot, 95 % of seeds", "mg/dl", _percentile("undershoot_mg_dl", 95.0), 8.0
    ),
    Claim("noise.peak", "noise", "peak above the setpoint, median", "mg/dl", _median("overshoot_mg_dl"), 6.0),
    Claim(
        "noise.variation",
        "noise",
        "total variation of insulin, median, against MPC/SE",
        "mU/min",
        _median("insulin_total_variation_mU_min"),
        "mpc-se",
        digits=1,
    ),
    Claim("dead-time-10.undershoot", "dead-time-10", "undershoot, median", "mg/dl", _median("undershoot_mg_dl"), 12.0),
    Claim(
        "dead-time-10.crossings",
        "dead-time-10",
        "no oscillation: crossings of the setpoint ± 2 %, the same loop without noise",
        "",
        _crossings,
        float(CROSSINGS_PER_MEAL - 1),
        digits=0,
        quiet=True,
    ),
    Claim(
        "dead-time-10.turns",
        "dead-time-10",
        "no oscillation: turns of insulin, the same loop without noise",
        "",
        _turns,
        float(TURNS_PER_MEAL - 1),
        digits=0,
        quiet=True,
    ),
    Claim(
        "dead-time-10.swings",
        "dead-time-10",
        f"no oscillation: swings beyond ±{SWING_MG_DL:g} mg/dl in the last {LATE_MIN:g} min, 95 % of seeds",
        "",
        _percentile("late_swings", 95.0),
        0.0,
        digits=0,
    ),
    Claim(
        "dead-time-15.lowest",
        "dead-time-15",
        "lowest glucose of any seed",
        "mg/dl",
        lambda loops: float(loops.numbers["minimum_mg_dl"].min()),
        60.0,
        at_least=True,
    ),
    Claim("announced.deviation", "announced", "largest deviation", "mg/dl", _greatest("deviation_mg_dl"), 1.0),
    Claim("people.below-60", "people", "people ever below 60 mg/dl", "", _below_60, 0.0, digits=0),
    Claim(
        "people.near",
        "people",
        f"time within {NEAR_MG_DL:g} mg/dl of the setpoint, median",
        "%",
        _median("time_near_pct"),
        99.0,
        at_least=True,
    ),
)


def verdicts(study: ComparisonRuns) -> list[Verdict]:
    """Result of each claim about a situation that was run."""
    found = []
    for claim in CLAIMS:
        loops = study.loops.get(claim.situation)
        if loops is None:
            continue
        of_each = {name: claim.found(own) for name, own in loops.items()}
        bound = of_each.get(claim.bound, math.nan) if isinstance(claim.bound, str) else claim.bound
        runs = f"one run, as of seed {study.asked.seed}" if claim.quiet else runs_told(study, claim.situation)
        found.append(Verdict(claim=claim, found=of_each, bound=bound, runs=runs, of=study.ours))
    return found


def runs_told(study: ComparisonRuns, situation: str) -> str:
    """Runs from which the numbers of a situation come, in words."""
    asked = study.asked
    runs = next(one.runs for one in study.situations if one.name == situation)
    if runs == "people":
        last = asked.people - 1
        return f"people 0 to {last} of seed {asked.seed}" if last else f"person 0 of seed {asked.seed}"
    if runs == "seeds":
        seeds = asked.sensor_seeds
        return f"seeds {seeds[0]} to {seeds[-1]}" if asked.seeds > 1 else f"seed {seeds[0]}"
    return "one run"


def spread(loops: ControllerRuns) -> dict[str, dict[str, float]]:
    """Percentiles of each measure over the runs, by measure and by name in `SHARES`."""
    return {
        measure.name: {name: float(np.percentile(loops.numbers[measure.name], share)) for name, share in SHARES.items()}
        for measure in MEASURES
    }


def distances(study: ComparisonRuns, situation: NamedSituation) -> dict[str, dict[str, float]]:
    """Excess of the largest deviation over the bound, by controller; empty where no bound is known.

    It is that of `bounds.distance_to_bound` for each run; percentiles of it are reported.
    """
    bound = study.bounds.get(situation.name)
    if bound is None:
        return {}
    return {
        name: {key: value - bound.bound for key, value in spread(loops)["deviation_mg_dl"].items()}
        for name, loops in study.loops[situation.name].items()
    }
