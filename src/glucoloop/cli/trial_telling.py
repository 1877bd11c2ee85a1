"""Output of a finished trial."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.request import Output
from glucoloop.cli.screen import show
from glucoloop.cli.telling import print_json
from glucoloop.printable import NOT_AVAILABLE, glucose_text, how_many, percent

if TYPE_CHECKING:
    from glucoloop.cohorts.trial import Trial
    from glucoloop.report.table import Row

_TABLE: Final = (
    ("time_70_180_pct", ("mean", "p5")),
    ("time_above_180_pct", ("mean", "p95")),
    ("time_above_250_pct", ("mean", "p95")),
    ("time_below_70_pct", ("mean", "p95")),
    ("time_below_54_pct", ("mean", "p95")),
    ("minimum_mg_dl", ("median", "min")),
    ("undershoot_mg_dl", ("median", "p95", "max")),
    ("peak_mg_dl", ("median", "p95")),
    ("mean_mg_dl", ("median",)),
    ("insulin_total_mU", ("median",)),
    ("insulin_off_min", ("median", "p95")),
)
"""Metrics and their statistics over the people, in the order in which a clinician reads them."""
_EVER_BELOW: Final = {"time_below_70_pct": "70", "time_below_54_pct": "54"}
"""Glucose below which people are counted, after the row of a metric."""
_NAMED: Final = 10


def tell(trial: Trial, summary: Mapping[str, Any], output: Output, out: Path) -> None:
    """Print a finished trial: its summary as one JSON object, or a table with notes."""
    from glucoloop.report.table import lines_table
    from glucoloop.storage.trials.folder import CONFIGURATION, FINAL

    notes = tuple(_notes(summary))
    if output.json:
        summary = {key: value for key, value in summary.items() if key != "version"}
        print_json(summary, {name: str(out / name) for name in sorted((*FINAL, CONFIGURATION))}, notes)
        return
    show(lines_table("Over the people", summary["controllers"], list(_rows(summary))))
    for line in (*notes, *(_mmol_lines(summary) if output.mmol else ())):
        print(line)
    print(f"Wrote {', '.join(FINAL)} and {trial.shards} {'shard' if trial.shards == 1 else 'shards'} to {out}.")


def _rows(summary: Mapping[str, Any]) -> Iterator[Row]:
    from glucoloop.parts.metrics import described
    from glucoloop.report.table import Row

    controllers = summary["controllers"].values()
    for metric, statistics in _TABLE:
        how = described(metric)
        for position, statistic in enumerate(statistics):
            values = (of["metrics"][metric][statistic] for of in controllers)
            cells = (NOT_AVAILABLE if v is None else how.text(v, summary["setpoint_mg_dl"]) for v in values)
            yield Row("", "" if position else how.title, how.unit, tuple(cells), second=statistic)
        if metric in _EVER_BELOW:
            limit = _EVER_BELOW[metric]
            counts = (of["ever_below"][f"{limit}_mg_dl"] for of in controllers)
            cells = (
                NOT_AVAILABLE if of["share_pct"] is None else f"{of['people']} ({percent(of['share_pct'])})"
                for of in counts
            )
            yield Row("", f"People ever below {limit} mg/dl", "", tuple(cells), second="number")
    if all("engine" in of for of in controllers):  # earlier versions did not tell it
        yield Row("", "Engine", "", tuple(of["engine"] for of in controllers))


def _notes(summary: Mapping[str, Any]) -> Iterator[str]:
    """Notes on people who are left out, and on people whose basal rate is beyond the pump."""
    infeasible, beyond = summary["unable"], summary["basal_beyond_pump"]
    setpoint = f"{summary['setpoint_mg_dl']:g} mg/dl"
    if count := infeasible["count"]:
        yield (
            f"Of {how_many(summary['people'], 'person', 'people')} {how_many(count, 'has', 'have')} no basal rate for "
            f"{setpoint}: {_persons(infeasible)}."
        )
    if beyond["count"]:
        yield (
            f"{how_many(beyond['count'], 'person', 'people')} would need more than the pump gives to rest there: "
            f"{_persons(beyond)}."
        )
    from glucoloop.report.facts import engine_notes

    yield from engine_notes(summary["controllers"])
    for label, of in summary["controllers"].items():
        below = of.get("below_validity", {"count": 0})  # earlier versions did not measure it
        if below["count"]:
            yield (
                f"{label}: glucose of {_people(below['count'])} was lower than the model is valid for: "
                f"{_persons(below)}. Read it as severe hypoglycemia; its depth means nothing."
            )
        if of["not_finite"]["count"]:
            lost = of["not_finite"]
            yield f"{label}: glucose of {_people(lost['count'])} did not stay finite: {_persons(lost)}."


def _people(count: int) -> str:
    return "one person" if count == 1 else f"{count} people"


def _persons(named: Mapping[str, Any]) -> str:
    shown = ", ".join(map(str, named["person"][:_NAMED]))
    return f"person {shown}" if named["count"] <= _NAMED else f"person {shown} and others, see summary.json"


def _mmol_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    from glucoloop.units import mmol_l_from_mg_dl

    for label, of in summary["controllers"].items():
        least, peak = of["metrics"]["minimum_mg_dl"], of["metrics"]["peak_mg_dl"]
        values = (least["median"], least["min"], peak["median"], peak["max"])
        if None not in values:
            median, worst, high, highest = (glucose_text(mmol_l_from_mg_dl(value), 2) for value in values)
            yield (
                f"{label}: least glucose {median} mmol/l in the median and {worst} at worst, "
                f"greatest {high} in the median and {highest} at worst."
            )
