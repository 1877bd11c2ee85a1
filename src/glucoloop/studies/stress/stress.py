"""A stress test: controllers, with and without a guard, on the same people under one fault after another.

It is a trial whose cases are all controllers under all faults. Each person has the same meals, noise and onset of a
fault under each controller.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.cohorts.people import Shard
from glucoloop.cohorts.trial import Trial
from glucoloop.experiments.case import Case
from glucoloop.parts.setting import Value
from glucoloop.refusal import Refusal
from glucoloop.studies.guarded import WITH_GUARD
from glucoloop.studies.options import Guards

NO_FAULT: Final = ""
MOST_MORE_PCT: Final = 1.0
"""Largest increase of the time below 60 mg/dl, in percent of the run, that a fault may cause for a cell to pass."""
MOST_NAMED: Final = 20

STANDARD_FAULTS: Final = (
    "missing, start_min=60, latest_min=300, duration_min=60",
    "missing, start_min=60, latest_min=180, duration_min=240",
    "late, start_min=60, latest_min=300, duration_min=120, delay_min=15",
    "repeated, start_min=60, latest_min=300, duration_min=120, times=3",
    "out-of-order, start_min=60, latest_min=300, duration_min=120, among=4",
    "spikes, per_day=12, size_mg_dl=60",
    "spikes, per_day=12, size_mg_dl=-40",
    "stuck, start_min=60, latest_min=300, duration_min=120",
    "drift, start_min=60, latest_min=300, mg_dl_h=3",
    "drift, start_min=60, latest_min=300, mg_dl_h=-3",
    "calibration, gain=1.15, offset_mg_dl=0",
    "calibration, gain=0.85, offset_mg_dl=0",
    "calibration, gain=1, offset_mg_dl=15",
    "compression, start_min=60, latest_min=300, duration_min=45, depth=0.3, tau_min=10",
    "saturation, low_mg_dl=75, high_mg_dl=400",
    "nonsense, start_min=60, latest_min=300, duration_min=60, value=nan",
    "nonsense, start_min=60, latest_min=300, duration_min=60, value=0",
    "nonsense, start_min=60, latest_min=300, duration_min=60, value=2000",
    "occlusion, start_min=60, latest_min=300, duration_min=120, open_fraction=0, noticed=false",
    "occlusion, start_min=60, latest_min=300, duration_min=120, open_fraction=0, noticed=true",
    "missed-pulses, share=0.2, noticed=false",
    "resolution, step_mU_min=4, least_mU_min=8",
    "battery, start_min=60, latest_min=300, duration_min=60",
)
"""Faults that are tried by default. Sensors that are wrong by 15 % or 15 mg/dl are as wrong as those of integrated
continuous monitors may be (U.S. Food and Drug Administration, 21 CFR 862.1355).
"""


@dataclass(frozen=True)
class Tried:
    """One cell of the test: a controller, guarded or not, under a fault or none."""

    controller: str
    """Label of the case."""
    guarded: bool
    fault: str
    """Full text of the fault; empty for none."""

    @property
    def label(self) -> str:
        """Label of the case of the trial."""
        return " | ".join(
            [self.controller, *(["guarded"] if self.guarded else []), *([self.fault] if self.fault else [])]
        )

    @property
    def without_fault(self) -> Tried:
        """Cell of the same controller without a fault, for comparison."""
        return dataclasses.replace(self, fault=NO_FAULT)


@dataclass(frozen=True)
class Stress:
    """A stress test."""

    trial: Trial
    """Trial with a case for each cell."""
    tried: tuple[Tried, ...]
    """The cells, in the order of the cases."""


def stress_of(base: Trial, faults: Sequence[str], guards: Guards, limits: Mapping[str, Value]) -> Stress:
    """Every case of a trial under every fault.

    Parameters
    ----------
    base : Trial
        Trial with a case for each controller.
    faults : sequence of str
        Full texts of faults, each tried alone.
    guards : {"both", "with", "without"}
    limits : mapping
        All limits of the guard.

    Raises
    ------
    ValueError
        For a fault that is given twice.
    """
    for fault in faults:
        if list(faults).count(fault) > 1:
            raise Refusal(f"the fault {fault!r} is given twice; leave one out")
    cases: list[Case] = []
    tried: list[Tried] = []
    for case in base.cases:
        for guarded in WITH_GUARD[guards]:
            for fault in (NO_FAULT, *faults):
                cell = Tried(controller=case.label, guarded=guarded, fault=fault)
                own = (fault,) if fault else ()
                cases.append(
                    dataclasses.replace(case, label=cell.label, guard=dict(limits) if guarded else None, faults=own)
                )
                tried.append(cell)
    return Stress(trial=dataclasses.replace(base, cases=tuple(cases)), tried=tuple(tried))


@dataclass(frozen=True)
class StressRow:
    """Results of a cell. Percentages of time are of the run, those of people of the people who took part."""

    tried: Tried
    people: int
    below_60_mean_pct: float
    """Time below 60 mg/dl, in percent, over all people."""
    below_60_worst_pct: float
    """Time below 60 mg/dl, in percent, of the person with the longest."""
    below_54_mean_pct: float
    below_54_worst_pct: float
    ever_below_60_pct: float
    """Percentage of the people who were ever below 60 mg/dl."""
    ever_below_54_pct: float
    lowest_mg_dl: float
    lowest_person: int
    highest_mg_dl: float
    low_events: int
    """Number of events below 70 mg/dl for 15 min or longer, over all people."""
    very_low_events: int
    """Number of events below 54 mg/dl, over all people."""
    saturated_pct: float
    """Percentage of the samples, over all people, at which the dose was cut to the pump's limits."""
    missing_pct: float
    rejected_pct: float
    fallback_pct: float
    suspended_pct: float
    dose_limited_pct: float
    worse: tuple[int, ...]
    """People whose time below 60 mg/dl was longer than without the fault by more than 1 % of the run, the worst first.
    """
    worst_more_pct: float
    """Largest such difference, of all people; 0 without a fault."""
    people_below_validity: int
    """Number of people whose glucose was ever below the range in which their model is valid."""

    @property
    def stands(self) -> bool:
        """Whether the cell passes: no person was much worse off than without the fault."""
        return not self.worse


_COLUMNS: Final = (
    *("time_below_60_pct", "time_below_54_pct", "minimum_mg_dl", "peak_mg_dl", "low_events", "very_low_events"),
    *("samples_saturated", "samples_missing", "samples_rejected", "samples_fallback", "samples_suspended"),
    "samples_dose_limited",
)


def stress_rows(stress: Stress, shards: Iterator[Shard]) -> list[StressRow]:
    """Results of each cell, from the people of the shards."""
    kept: dict[str, list[dict[str, npt.NDArray[Any]]]] = {cell.label: [] for cell in stress.tried}
    for shard in shards:
        for label, people in shard.items():
            known = people.feasible & np.isfinite(people.metrics["mean_mg_dl"])
            part = {name: people.metrics[name] for name in _COLUMNS} | {
                "person": people.person,
                "known": known,
                "below_validity": people.below_validity,
            }
            kept[label].append(part)
    whole = {
        label: {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        for label, parts in kept.items()
    }
    return [
        _row(cell, whole[cell.label], whole[cell.without_fault.label], stress.trial.samples) for cell in stress.tried
    ]


def _row(
    cell: Tried, told: Mapping[str, npt.NDArray[Any]], without: Mapping[str, npt.NDArray[Any]], samples: int
) -> StressRow:
    known = told["known"] & without["known"]
    of = {name: values[known] for name, values in told.items()}
    if not known.any():
        of = {name: np.full(1, np.nan) for name in told}
    more = of["time_below_60_pct"] - without["time_below_60_pct"][known] if known.any() else np.zeros(1)
    order = np.argsort(-more, kind="stable")
    lowest = int(np.argmin(of["minimum_mg_dl"]))

    def share(name: str) -> float:
        return float(100.0 * of[name].mean() / samples)

    return StressRow(
        tried=cell,
        people=int(known.sum()),
        below_60_mean_pct=float(of["time_below_60_pct"].mean()),
        below_60_worst_pct=float(of["time_below_60_pct"].max()),
        below_54_mean_pct=float(of["time_below_54_pct"].mean()),
        below_54_worst_pct=float(of["time_below_54_pct"].max()),
        ever_below_60_pct=float(100.0 * (of["minimum_mg_dl"] < 60.0).mean()),
        ever_below_54_pct=float(100.0 * (of["minimum_mg_dl"] < 54.0).mean()),
        lowest_mg_dl=float(of["minimum_mg_dl"][lowest]),
        lowest_person=int(of["person"][lowest]) if known.any() else -1,
        highest_mg_dl=float(of["peak_mg_dl"].max()),
        low_events=int(np.nansum(of["low_events"])),
        very_low_events=int(np.nansum(of["very_low_events"])),
        saturated_pct=share("samples_saturated"),
        missing_pct=share("samples_missing"),
        rejected_pct=share("samples_rejected"),
        fallback_pct=share("samples_fallback"),
        suspended_pct=share("samples_suspended"),
        dose_limited_pct=share("samples_dose_limited"),
        worse=tuple(int(of["person"][i]) for i in order if more[i] > MOST_MORE_PCT),
        worst_more_pct=float(more.max()),
        people_below_validity=int(np.nansum(of["below_validity"])),
    )


@dataclass(frozen=True)
class Reason:
    """Reason why a person was worse off under a fault."""

    tried: Tried
    person: int
    more_pct: float
    """Increase of the time below 60 mg/dl over that without the fault, in percent."""
    text: str
    """Description of the person's run, in a few sentences."""


@dataclass(frozen=True)
class StressResult:
    """Results of a stress test."""

    rows: tuple[StressRow, ...]
    reasons: tuple[Reason, ...]
    """Reasons for the worst person of each guarded cell in which a person was worse off."""
    facts: Mapping[str, str]
    """Facts about people, meals and sensor, for the head of a page."""
    repeat: str
    """Command that repeats the test from its folder, without the name of the program."""
    keys: Mapping[str, Any] = field(default_factory=dict)
    given: Mapping[str, Any] | None = None
    """Configuration of the test."""
    able: int | None = None
    """Number of people with a basal rate; by default all of them are in a row."""
    infeasible: int = 0
    """Number of people without a basal rate, who are in no row."""
