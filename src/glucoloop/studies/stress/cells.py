"""Cells of a stress test, each a case of a trial, and the numbers of a cell."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import polars as pl

from glucoloop.cohorts.trial import Trial
from glucoloop.printable import NOT_AVAILABLE, NOT_VALID
from glucoloop.report.columns import Column, Row, measured, terse_percent, whole, whole_glucose
from glucoloop.situations.case import Case
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


def cells_of(asked: StressTest) -> dict[StressCell, Case]:
    """The case of a trial for each cell."""
    faults = {NO_FAULT: (), **{text: (fault,) for text, fault in zip(asked.fault_texts, asked.faults, strict=True)}}
    cells = {}
    for case in asked.cases:
        for guarded in WITH_GUARD[asked.guards]:
            in_cell = asked.with_guard(case, guarded)
            for text, fault in faults.items():
                cell = StressCell(case.label, guarded, text)
                cells[cell] = dataclasses.replace(in_cell, label=cell.label, faults=fault)
    return cells


def trial_of(asked: StressTest) -> Trial:
    """Trial with a case for each cell."""
    return asked.with_cases(tuple(cells_of(asked).values()), faults=())


def cell_table(cells: Iterable[StressCell], people: pl.DataFrame, samples: int) -> pl.DataFrame:
    """The numbers of each cell, over the people whose glucose stayed finite there and without the fault.

    `people` are those of each cell, from `people_table`; `samples` is the number of samples of a run.
    """
    labels = pl.DataFrame([{"label": cell.label, **dataclasses.asdict(cell)} for cell in cells])
    known = people.join(labels, on="label", maintain_order="left")
    known = known.filter("feasible", pl.col("mean_mg_dl").is_finite())
    same = ["controller", "guarded", "person"]
    without = known.filter(fault=NO_FAULT).select(*same, without_pct="time_below_60_pct")
    known = known.join(without, on=same, how="inner", maintain_order="left")
    known = known.with_columns(more_pct=pl.col("time_below_60_pct") - pl.col("without_pct"), samples=samples)
    return measured(known, labels.drop("label"), COLUMNS)


def _guarded(row: Row) -> bool:
    return bool(row["guarded"])


def _share(kind: str, short: str | None = None, **others: Any) -> Column:
    """Percentage of the samples that are of a kind."""
    value = 100.0 * pl.col(f"samples_{kind}").mean() / pl.col("samples").first()
    head = kind.removeprefix("dose_")
    return Column(
        name=f"{kind}_pct", value=value, group="Samples (%)", head=head, short=short, short_text=terse_percent, **others
    )


_60, _54, _LOWEST = pl.col("time_below_60_pct"), pl.col("time_below_54_pct"), pl.col("minimum_mg_dl")
_MORE, _PERSON = pl.col("more_pct"), pl.col("person")
_WORSE: Final = _MORE > MOST_MORE_PCT
_worse_off = functools.partial(Column, group="Worse off", strong=lambda row: bool(row["worse"]))
_below_60 = functools.partial(Column, group="Time below 60 (%)", short_text=terse_percent)
_below_54 = functools.partial(Column, group="Time below 54 (%)", short_text=terse_percent)
_ever_below = functools.partial(Column, group="People ever below (%)")
_glucose = functools.partial(Column, group="Glucose (mg/dl)", text=whole_glucose)
_events = functools.partial(Column, group="Events", text=whole)
COLUMNS: Final = (
    Column(name="people", value=pl.len(), empty=0, text=whole),
    _worse_off(name="worse", value=_WORSE.sum(), head="people", text=whole, short="worse\noff"),
    Column(
        name="worse_people",
        value=_PERSON.filter(_WORSE).sort_by(_MORE.filter(_WORSE), descending=True, maintain_order=True),
    ),
    _worse_off(name="worst_more_pct", value=_MORE.max(), head="most (%)"),
    _below_60(name="below_60_mean_pct", value=_60.mean(), head="mean", short="<60\nmean"),
    _below_60(name="below_60_worst_pct", value=_60.max(), head="longest", short="<60\nlongest"),
    _below_54(name="below_54_mean_pct", value=_54.mean(), head="mean"),
    _below_54(name="below_54_worst_pct", value=_54.max(), head="longest", short="<54\nlongest"),
    _ever_below(name="ever_below_60_pct", value=100.0 * (_LOWEST < 60.0).mean(), head="60"),
    _ever_below(name="ever_below_54_pct", value=100.0 * (_LOWEST < 54.0).mean(), head="54"),
    Column(
        name="people_below_validity",
        value=(pl.col("time_below_validity_pct") > 0.0).sum(),
        group="Model not valid",
        head="people",
        text=whole,
    ),
    _glucose(
        name="lowest_mg_dl",
        # below 0 it is no concentration: the model is not valid
        value=pl.when(_LOWEST.min() >= 0.0).then(_LOWEST.min()),
        head="lowest",
        missing=lambda row: NOT_VALID if row["people"] else NOT_AVAILABLE,
        short="lowest\nmg/dl",
    ),
    _glucose(name="lowest_person", value=_PERSON.get(_LOWEST.arg_min()), head="of person", text=whole),
    _glucose(name="highest_mg_dl", value=pl.col("peak_mg_dl").max(), head="highest"),
    _events(name="low_events", value=pl.col("low_events").sum().cast(pl.Int64), head="low", short="low\nevents"),
    _events(name="very_low_events", value=pl.col("very_low_events").sum().cast(pl.Int64), head="very low"),
    _share("saturated", "\nsat."),
    _share("missing"),
    _share("rejected"),
    _share("fallback", "fall\nback", only=_guarded),
    _share("suspended", "\nsusp.", only=_guarded),
    _share("dose_limited"),
)
"""The numbers of a cell, of which the people who were worse off come first."""
