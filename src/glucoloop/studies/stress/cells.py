"""Cells of a stress test, each a case of a trial, and the numbers of a cell."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import polars as pl

from glucoloop.cohorts.trial import Trial
from glucoloop.printable import NOT_AVAILABLE, NOT_VALID
from glucoloop.report.columns import Column, Row, measured, terse_percent, whole, whole_glucose
from glucoloop.studies.guarded import WITH_GUARD
from glucoloop.studies.stress import StressTest

NO_FAULT: Final = ""
MOST_MORE_PCT: Final = 1.0
"""Largest increase of the time below 60 mg/dl, in percent of the run, that a fault may cause for a cell to pass."""


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


def cells_of(asked: StressTest) -> list[StressCell]:
    """The cells, in the order of the cases."""
    return [
        StressCell(case.label, guarded, fault)
        for case in asked.cases
        for guarded in WITH_GUARD[asked.guards]
        for fault in (NO_FAULT, *asked.fault_texts)
    ]


def trial_of(asked: StressTest) -> Trial:
    """Trial with a case for each cell."""
    of = {case.label: case for case in asked.cases}
    faults = dict(zip(asked.fault_texts, asked.faults, strict=True))
    return asked.with_cases(
        tuple(
            dataclasses.replace(
                asked.with_guard(of[cell.controller], cell.guarded),
                label=cell.label,
                faults=(faults[cell.fault],) if cell.fault else (),
            )
            for cell in cells_of(asked)
        ),
        faults=(),
    )


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
