"""Cells of a stress test, each a case of a trial, and the numbers of a cell."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import polars as pl

from glucoloop.cohorts.trial import Trial
from glucoloop.config.cases import given_with
from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys
from glucoloop.config.run import faults_told
from glucoloop.config.trial import with_people
from glucoloop.parts.setting import Value
from glucoloop.printable import NOT_AVAILABLE, NOT_VALID
from glucoloop.refusal import Refusal
from glucoloop.report.columns import Column, Row, measured, terse_percent, whole, whole_glucose
from glucoloop.studies.guarded import WITH_GUARD, guarded_trial_keys, read_guarded_trial
from glucoloop.studies.stress import STRESS, StressSettings

NO_FAULT: Final = ""
MOST_MORE_PCT: Final = 1.0
"""Largest increase of the time below 60 mg/dl, in percent of the run, that a fault may cause for a cell to pass."""
_SHARD_PEOPLE: Final = 128

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
class StressCell:
    """A controller, with or without a guard, under a fault or none."""

    controller: str
    """Label of the case."""
    guarded: bool
    fault: str
    """Full text of the fault; empty for none."""

    @property
    def label(self) -> str:
        """Label of the case of the trial."""
        return " | ".join(filter(None, (self.controller, "guarded" if self.guarded else "", self.fault)))


@dataclass(frozen=True)
class StressTest:
    """A stress test that is complete and checked."""

    base: Trial
    """Trial with a case for each controller, without faults."""
    own: StressSettings
    """Settings of the test, with the full texts of the faults."""
    limits: Mapping[str, Value]
    """All limits of the guard."""
    given: Mapping[str, Any] | None = field(default=None, compare=False)
    """Flat keys from which it was read, if it was."""

    @property
    def faults(self) -> tuple[str, ...]:
        """Full texts of the faults."""
        return self.own.faults or ()

    @property
    def cells(self) -> list[StressCell]:
        """The cells, in the order of the cases."""
        return [
            StressCell(case.label, guarded, fault)
            for case in self.base.cases
            for guarded in WITH_GUARD[self.own.guards]
            for fault in (NO_FAULT, *self.faults)
        ]

    @property
    def trial(self) -> Trial:
        """Trial with a case for each cell."""
        of = {case.label: case for case in self.base.cases}
        cases = [
            dataclasses.replace(
                of[cell.controller],
                label=cell.label,
                guard=dict(self.limits) if cell.guarded else None,
                faults=(cell.fault,) if cell.fault else (),
            )
            for cell in self.cells
        ]
        return dataclasses.replace(self.base, cases=tuple(cases))

    def keys(self) -> dict[str, Any]:
        """The flat keys of all values that are used."""
        own = {"faults": list(self.faults), "guards": self.own.guards}
        return guarded_trial_keys(self.base, own, self.limits, STRESS.refused)


def read(
    keys: Mapping[str, Any], cases: Sequence[Mapping[str, Any]] = (), names: Mapping[str, str] | None = None
) -> StressTest:
    """Read the configuration of a stress test; Refusal for a key that is unknown, wrong or at odds with another."""
    own = checked(StressSettings, own_keys(keys, StressSettings), names)
    base, limits = read_guarded_trial(
        keys,
        cases,
        names,
        what=STRESS.what,
        usual=STRESS.usual,
        own=declared(StressSettings),
        refused=STRESS.refused,
    )
    if "shard_people" not in keys:
        # Slow controllers under many faults: so that not much is lost when a run is cut short.
        base = dataclasses.replace(base, shard_people=min(base.people, base.shard_people, _SHARD_PEOPLE))
    horizon_min = base.plan.horizon_min
    if own.faults is None:
        faults = faults_told(STANDARD_FAULTS, horizon_min)
    elif not own.faults:
        called = (names or {}).get("faults", "faults")
        raise Refusal(f"{called} is []; give a list of faults, like ['missing, start_min=60, duration_min=30']")
    else:
        faults = faults_told(own.faults, horizon_min, allow_unusual=base.allow_unusual)
    for fault in faults:
        if faults.count(fault) > 1:
            raise Refusal(f"the fault {fault!r} is given twice; leave one out")
    given = given_with(with_people(keys, base.population), cases)
    return StressTest(base=base, own=dataclasses.replace(own, faults=faults), limits=limits, given=given)


def cell_table(cells: Sequence[StressCell], people: pl.DataFrame, samples: int) -> pl.DataFrame:
    """The numbers of each cell, over the people whose glucose stayed finite there and without the fault.

    Parameters
    ----------
    cells : sequence of StressCell
    people : polars.DataFrame
        The people of each cell, from `people_table`.
    samples : int
        Number of samples of a run.
    """
    labels = pl.DataFrame([{"label": cell.label, **dataclasses.asdict(cell)} for cell in cells])
    known = people.join(labels, on="label", maintain_order="left")
    known = known.filter("feasible", pl.col("mean_mg_dl").is_finite())
    of = ["controller", "guarded", "person"]
    without = known.filter(fault=NO_FAULT).select(*of, without_pct="time_below_60_pct")
    known = known.join(without, on=of, how="inner", maintain_order="left")
    known = known.with_columns(more_pct=pl.col("time_below_60_pct") - pl.col("without_pct"), samples=samples)
    return measured(known, labels.drop("label"), COLUMNS)


def _samples_pct(what: str) -> pl.Expr:
    return 100.0 * pl.col(f"samples_{what}").mean() / pl.col("samples").first()


def _fails(row: Row) -> bool:
    return bool(row["worse"])


def _guarded(row: Row) -> bool:
    return bool(row["guarded"])


_60, _54, _LOWEST = pl.col("time_below_60_pct"), pl.col("time_below_54_pct"), pl.col("minimum_mg_dl")
_WORSE: Final = pl.col("more_pct") > MOST_MORE_PCT
_BELOW_60, _BELOW_54, _EVER = "Time below 60 (%)", "Time below 54 (%)", "People ever below (%)"
_GLUCOSE, _EVENTS, _SAMPLES, _MORE = "Glucose (mg/dl)", "Events", "Samples (%)", "Worse off"
COLUMNS: Final = (
    Column(name="people", of=pl.len(), empty=0, text=whole),
    Column(name="worse", of=_WORSE.sum(), group=_MORE, head="people", text=whole, short="worse\noff", strong=_fails),
    Column(
        name="worse_people",
        of=pl.col("person")
        .filter(_WORSE)
        .sort_by(pl.col("more_pct").filter(_WORSE), descending=True, maintain_order=True),
    ),
    Column(name="worst_more_pct", of=pl.col("more_pct").max(), group=_MORE, head="most (%)", strong=_fails),
    Column(
        name="below_60_mean_pct",
        of=_60.mean(),
        group=_BELOW_60,
        head="mean",
        short="<60\nmean",
        short_text=terse_percent,
    ),
    Column(
        name="below_60_worst_pct",
        of=_60.max(),
        group=_BELOW_60,
        head="longest",
        short="<60\nlongest",
        short_text=terse_percent,
    ),
    Column(name="below_54_mean_pct", of=_54.mean(), group=_BELOW_54, head="mean"),
    Column(
        name="below_54_worst_pct",
        of=_54.max(),
        group=_BELOW_54,
        head="longest",
        short="<54\nlongest",
        short_text=terse_percent,
    ),
    Column(name="ever_below_60_pct", of=100.0 * (_LOWEST < 60.0).mean(), group=_EVER, head="60"),
    Column(name="ever_below_54_pct", of=100.0 * (_LOWEST < 54.0).mean(), group=_EVER, head="54"),
    Column(
        name="people_below_validity",
        of=(pl.col("time_below_validity_pct") > 0.0).sum(),
        group="Model not valid",
        head="people",
        text=whole,
    ),
    Column(
        name="lowest_mg_dl",
        of=pl.when(_LOWEST.min() >= 0.0).then(_LOWEST.min()),  # below 0 it is no concentration: the model is not valid
        group=_GLUCOSE,
        head="lowest",
        text=whole_glucose,
        missing=lambda row: NOT_VALID if row["people"] else NOT_AVAILABLE,
        short="lowest\nmg/dl",
    ),
    Column(
        name="lowest_person", of=pl.col("person").get(_LOWEST.arg_min()), group=_GLUCOSE, head="of person", text=whole
    ),
    Column(name="highest_mg_dl", of=pl.col("peak_mg_dl").max(), group=_GLUCOSE, head="highest", text=whole_glucose),
    Column(
        name="low_events",
        of=pl.col("low_events").sum().cast(pl.Int64),
        group=_EVENTS,
        head="low",
        text=whole,
        short="low\nevents",
    ),
    Column(
        name="very_low_events",
        of=pl.col("very_low_events").sum().cast(pl.Int64),
        group=_EVENTS,
        head="very low",
        text=whole,
    ),
    Column(
        name="saturated_pct",
        of=_samples_pct("saturated"),
        group=_SAMPLES,
        head="saturated",
        short="\nsat.",
        short_text=terse_percent,
    ),
    Column(name="missing_pct", of=_samples_pct("missing"), group=_SAMPLES, head="missing"),
    Column(name="rejected_pct", of=_samples_pct("rejected"), group=_SAMPLES, head="rejected"),
    Column(
        name="fallback_pct",
        of=_samples_pct("fallback"),
        group=_SAMPLES,
        head="fallback",
        short="fall\nback",
        short_text=terse_percent,
        only=_guarded,
    ),
    Column(
        name="suspended_pct",
        of=_samples_pct("suspended"),
        group=_SAMPLES,
        head="suspended",
        short="\nsusp.",
        short_text=terse_percent,
        only=_guarded,
    ),
    Column(name="dose_limited_pct", of=_samples_pct("dose_limited"), group=_SAMPLES, head="limited"),
)
"""The numbers of a cell, of which the people who were worse off come first."""
