"""Claims about the meal-aware controller: each is a number of its runs, with a bound."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from glucoloop.papers.meal_aware.measures import LATE_MIN, NEAR_MG_DL, SWING_MG_DL, Floats
from glucoloop.papers.meal_aware.mismatches import MISMATCHES
from glucoloop.tuning.oscillation import CROSSINGS_PER_MEAL, TURNS_PER_MEAL, Oscillation


class Runs(Protocol):
    """Runs of one controller in one situation."""

    @property
    def run(self) -> npt.NDArray[np.int64]:
        """(runs,) seeds or numbers of the runs."""
        ...

    @property
    def numbers(self) -> Mapping[str, Floats]:
        """(runs,) values of each measure, by its name."""
        ...

    @property
    def infeasible(self) -> int:
        """Number of people without a basal rate for the setpoint, who are not among the runs."""
        ...


Found = Callable[..., float]


@dataclass(frozen=True)
class Claim:
    """A claim about the meal-aware controller."""

    id: str
    situation: str
    """Name of a situation, or of a group of situations."""
    what: str
    unit: str
    found: Found
    """Function from the runs of a controller, in each of the situations, to the number that the bound is about."""
    bound: float | str
    """A number, or the name of a controller whose own number from the same runs is the bound."""
    at_least: bool = False
    """Whether the bound is the least value rather than the greatest."""
    digits: int = 2
    quiet: bool = False
    """Whether the claim is about the run without noise, and not about the seeds."""
    rows: tuple[str, ...] = ()
    """Names of situations of the group, from whose runs the number comes; for several, that of the worst one."""

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the situations whose runs the claim needs."""
        return self.rows or (self.situation,)


def _percentile(measure: str, share: float) -> Found:
    return lambda *situations: max(float(np.percentile(runs.numbers[measure], share)) for runs in situations)


def _greatest(measure: str) -> Found:
    return lambda *situations: max(float(runs.numbers[measure].max()) for runs in situations)


def _median(measure: str) -> Found:
    return _percentile(measure, 50.0)


def _lowest(*situations: Runs) -> float:
    return min(float(runs.numbers["minimum_mg_dl"].min()) for runs in situations)


def _offset(*situations: Runs) -> float:
    return max(abs(float(runs.numbers["late_offset_mg_dl"].mean())) for runs in situations)


def _below_60(runs: Runs) -> float:
    return float((runs.numbers["minimum_mg_dl"] < 60.0).sum())


def _more_below_60(without: Runs, *faulty: Runs) -> float:
    """Most by which a fault lengthens a person's time below 60 mg/dl, in percent of the run."""
    below = "time_below_60_pct"
    return max(float((runs.numbers[below] - without.numbers[below]).max()) for runs in faulty)


def _quiet(runs: Runs) -> Oscillation | None:
    found: Oscillation | None = getattr(runs, "quiet", None)
    return found


def _crossings(runs: Runs) -> float:
    quiet = _quiet(runs)
    return math.nan if quiet is None else float(quiet.crossings)


def _turns(runs: Runs) -> float:
    quiet = _quiet(runs)
    return math.nan if quiet is None else float(quiet.turns)


_ALONE: Final = (
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


def _rows(*names: str) -> tuple[str, ...]:
    return tuple(row.name for row in MISMATCHES if row.name in names)


def _undershoots(id: str, group: str, row: str, median: float, most: float, of: str = "") -> tuple[Claim, Claim]:
    """Claims about the median and 95 % of the undershoots of a situation."""
    rows, of = _rows(row), f"{of}: " if of else ""
    return (
        Claim(id, group, f"{of}undershoot, median", "mg/dl", _median("undershoot_mg_dl"), median, rows=rows),
        Claim(
            f"{id}-95", group, f"{of}undershoot, 95 %", "mg/dl", _percentile("undershoot_mg_dl", 95.0), most, rows=rows
        ),
    )


_STILL: Final = tuple(row.name for row in MISMATCHES if row.group == "setpoints" and row.variance == 0.0)
_NOISY_SETPOINTS: Final = tuple(row.name for row in MISMATCHES if row.group == "setpoints" and row.variance > 0.0)
_STOMACHS: Final = tuple(row.name for row in MISMATCHES if row.group == "stomachs")
_LATE: Final = tuple(row.name for row in MISMATCHES if row.group == "late")
_VARIATION: Final = f"total variation of insulin in the last {LATE_MIN:g} min, median, against MPC/SE"

_MISMATCHED: Final = (
    Claim(
        "meal.noise-free",
        "meal",
        "without noise: undershoot",
        "mg/dl",
        _greatest("undershoot_mg_dl"),
        2.0,
        rows=_rows("50 g, no noise"),
    ),
    *_undershoots("meal.noise", "meal", "50 g, white", 5.5, 7.5, "noise of variance 1.45"),
    *_undershoots("fasting.noise", "fasting", "fasting, white", 2.5, 3.5, "noise of variance 1.45"),
    Claim(
        "fasting.offset",
        "fasting",
        "distance of the mean from the setpoint at rest, with and without noise",
        "mg/dl",
        _offset,
        0.3,
        rows=_rows("fasting, no noise", "fasting, white"),
    ),
    Claim(
        "fasting.variation",
        "fasting",
        f"noise of variance 1.45: {_VARIATION}",
        "mU/min",
        _median("late_variation_mU_min"),
        "mpc-se",
        digits=1,
        rows=_rows("fasting, white"),
    ),
    *_undershoots("correlated.meal", "correlated", "50 g, correlated", 8.0, 11.0, "50 g"),
    *_undershoots("correlated.fasting", "correlated", "fasting, correlated", 4.0, 6.0, "nobody eats"),
    *_undershoots("juice.undershoot", "juice", "15 g of juice, white", 6.0, 8.0),
    *_undershoots("gaps.end", "gaps", "hour without readings as a meal ends", 7.0, 10.0, "as a meal ends"),
    Claim(
        "pump-faults.blocked",
        "pump-faults",
        "line blocked for 2 h: lowest glucose of anybody",
        "mg/dl",
        _lowest,
        55.0,
        at_least=True,
        rows=_rows("people, blocked line"),
    ),
    Claim(
        "pump-faults.battery",
        "pump-faults",
        "pump without a battery for 1 h: lowest glucose of anybody",
        "mg/dl",
        _lowest,
        60.0,
        at_least=True,
        rows=_rows("people, battery gap"),
    ),
    Claim(
        "late.lowest",
        "late",
        "lowest glucose of anybody, people of parker2000 and at corners of 40 %",
        "mg/dl",
        _lowest,
        54.0,
        at_least=True,
        rows=_LATE,
    ),
    Claim(
        "setpoints.swing",
        "setpoints",
        f"without noise, the worst setpoint: highest less lowest glucose in the last {LATE_MIN:g} min",
        "mg/dl",
        _greatest("late_swing_mg_dl"),
        0.5,
        rows=_STILL,
    ),
    *(
        Claim(
            f"setpoints.variation-{name.split(',')[0].split()[1]}",
            "setpoints",
            f"{name}: {_VARIATION}",
            "mU/min",
            _median("late_variation_mU_min"),
            "mpc-se",
            digits=1,
            rows=(name,),
        )
        for name in _NOISY_SETPOINTS
    ),
    Claim(
        "stomachs.undershoot-95",
        "stomachs",
        "undershoot, 95 %, of the worst one",
        "mg/dl",
        _percentile("undershoot_mg_dl", 95.0),
        9.0,
        rows=_STOMACHS,
    ),
    Claim(
        "guarded.peak",
        "guarded",
        "no fault: peak after 50 g, median above the setpoint of 81 mg/dl",
        "mg/dl",
        _median("overshoot_mg_dl"),
        19.0,
        rows=_rows("guarded, no fault"),
    ),
    Claim(
        "guarded.worse",
        "guarded",
        "blocked line, battery gap, hour without readings: most that one adds to a person's time below 60 mg/dl",
        "% of the run",
        _more_below_60,
        1.0,
        rows=_rows(
            "guarded, no fault", "guarded, blocked line", "guarded, battery gap", "guarded, hour without readings"
        ),
    ),
)
"""Claims where the model is wrong; their bounds were set before the controller was changed to keep them."""

CLAIMS: Final = (*_ALONE, *_MISMATCHED)
