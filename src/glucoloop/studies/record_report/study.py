"""Work of a report on records: reading, metrics, tables, and the page."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import polars as pl

from glucoloop.metrics.readings.catalogue import numbers_of
from glucoloop.metrics.readings.distribution import gri_zone
from glucoloop.metrics.readings.episodes import BOUNDS_MG_DL, glucose_episodes
from glucoloop.metrics.readings.profile import by_day, day_profile
from glucoloop.metrics.readings.series import Readings
from glucoloop.printable import how_many, percent
from glucoloop.records import read_record
from glucoloop.refusal import Refusal
from glucoloop.report.columns import FittingTable, lines_table
from glucoloop.report.print_figure import figure_files
from glucoloop.report.record_figure import plot_records
from glucoloop.report.record_page import GOALS, MOST_IN_FULL, ReportedRecord, number_rows, record_page, warnings
from glucoloop.storage.findings import Findings
from glucoloop.studies.record_report import Period, RecordRequest, period_of
from glucoloop.studies.record_report.simulated import simulated_courses
from glucoloop.units import MIN_PER_DAY

Source = tuple[str, Readings, tuple[str, ...]]
"""Label, readings and notes of a record."""


def found(asked: RecordRequest, progress: Callable[[str], None]) -> Findings:
    """Read the records, and compute their metrics."""
    periods = [period_of(text) for text in asked.periods]
    records = []
    for label, readings, notes in _sources(asked):
        for period in periods or [Period("")]:
            chosen = within(readings, period, label)
            name = label if len(periods) < 2 else f"{label}: {period.text.replace('/', ' to ')}"
            records.append(ReportedRecord(name, chosen, numbers_of(chosen), notes))
        progress(label)
    plain = {
        "records": [_plain(record) for record in records],
        "goals": asked.goals,
        "notes": list(warnings(records)),
    }
    return Findings(plain, _tables(records), records)


def _sources(asked: RecordRequest) -> Iterator[Source]:
    for place, name in enumerate(asked.files):
        label = asked.labels[place] if asked.labels else f"Record {place + 1}"
        path = Path(name)
        if path.is_dir():
            courses = simulated_courses(path)
            for case, readings in courses.items():
                own = f"{label}: {case}" if asked.labels or len(asked.files) > 1 else case
                yield own if len(courses) > 1 else label, readings, ("A simulated course; its first minute is 0 h.",)
        else:
            yield _read(asked, path, label)


def _read(asked: RecordRequest, path: Path, label: str) -> Source:
    """A record of a monitor."""
    record = read_record(
        path,
        reader=asked.reader,
        dates=asked.dates,
        glucose_unit=asked.glucose_unit,
        time_zone=asked.time_zone,
        columns=asked.columns,
        scans=asked.scans,
    )
    read = record.frame.filter(pl.col("glucose_mg_dl").is_finite())
    try:
        readings = Readings.of_times(read["time"].to_numpy(), read["glucose_mg_dl"].to_numpy())
    except Refusal as error:
        raise Refusal(f"{path}: {error}") from None
    averaged = read.height - readings.t_min.size
    more = (f"{how_many(averaged, 'reading')} at the time of another one: their mean was taken.",) if averaged else ()
    return label, readings, (*record.notes, *more)


def within(readings: Readings, period: Period, label: str) -> Readings:
    """The readings of a period; Refusal where it holds fewer than two."""
    if period.days:
        chosen = readings.t_min > readings.t_min[-1] - MIN_PER_DAY * period.days
    elif period.first is None or period.last is None:
        return readings
    elif readings.day_0 is None:
        raise Refusal(f"{label} is simulated and has no dates; give --period last-14")
    else:
        first, last = ((day - readings.day_0) // dt.timedelta(days=1) for day in (period.first, period.last))
        chosen = (readings.day >= first) & (readings.day <= last)
    part = readings.only(chosen)
    if part is None:
        first_day, last_day = (readings.date(int(readings.day[end])) for end in (0, -1))
        raise Refusal(
            f"{label} has {np.count_nonzero(chosen)} readings in --period {period.text}; its readings are from "
            f"{first_day} to {last_day}"
        )
    return part


def _plain(record: ReportedRecord) -> dict[str, Any]:
    about = {"label": record.label, "days_reported": record.dates, "sufficient": record.sufficient}
    return {**about, **record.numbers, "gri_zone": gri_zone(record.numbers["gri"]), "read": list(record.notes)}


def _tables(records: Sequence[ReportedRecord]) -> dict[str, pl.DataFrame]:
    metrics = pl.DataFrame([{"record": one.label, **one.numbers} for one in records]).fill_nan(None)
    days = [
        {"record": one.label, "day": one.readings.date(day), **of}
        for one in records
        for day, of in by_day(one.readings)
    ]
    listed = [
        (one.label, kind, one.readings.moment(ep.t_min), ep.duration_min, ep.extreme_mg_dl, ep.extended, ep.nocturnal)
        for one in records
        for kind in BOUNDS_MG_DL
        for ep in glucose_episodes(one.readings, kind)
    ]
    return {
        "metrics.csv": metrics,
        "metrics.parquet": metrics,
        "days.csv": pl.DataFrame(days).fill_nan(None) if days else pl.DataFrame(schema={"record": pl.String}),
        "episodes.csv": pl.DataFrame(listed, schema=_EPISODE_COLUMNS, orient="row"),
        "profile.csv": pl.concat(_profile_table(one) for one in records),
    }


_EPISODE_COLUMNS: Final = {
    "record": pl.String,
    "kind": pl.String,
    "begin": pl.String,
    "duration_min": pl.Float64,
    "extreme_mg_dl": pl.Float64,
    "extended": pl.Boolean,
    "nocturnal": pl.Boolean,
}


def _profile_table(record: ReportedRecord) -> pl.DataFrame:
    profile = day_profile(record.readings)
    curves = {f"glucose_{name}_pct_mg_dl": values for name, values in profile.percentiles_mg_dl.items()}
    columns = {"time_of_day_min": profile.t_min, "readings": profile.readings, **curves}
    return pl.DataFrame(columns).fill_nan(None).select(pl.lit(record.label).alias("record"), pl.all())


def tables(asked: RecordRequest, found: Findings) -> Iterator[object]:
    """All metrics side by side, or the first ones of many records."""
    records: list[ReportedRecord] = found.extra
    if len(records) <= MOST_IN_FULL:
        yield lines_table("Metric", [one.label for one in records], number_rows(records))
    else:
        yield FittingTable(_rows_table(records))


def _rows_table(records: Sequence[ReportedRecord]) -> Any:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("Record", "Days", "Active", "GMI", "CV", "< 54", "< 70", "70-180", "> 180", "> 250", "GRI"):
        table.add_column(head, justify="left" if head == "Record" else "right")
    shares = ("below_54", "below_70", "70_180", "above_180", "above_250")
    for one in records:
        of = one.numbers
        first = [f"{of['days']:.1f}", percent(of["active_pct"]), f"{of['gmi_pct']:.1f} %", percent(of["cv_pct"])]
        table.add_row(Text(one.label), *first, *(percent(of[f"time_{s}_pct"]) for s in shares), f"{of['gri']:.1f}")
    return table


def drawn(asked: RecordRequest, found: Findings) -> dict[str, bytes]:
    """The page, and the figure."""
    records, goals = found.extra, GOALS[asked.goals]
    page = {"report.html": record_page(records, goals).encode()}
    return {**page, **figure_files("figure", plot_records(records, goals))}


def how_to_go_on(found: Findings, files: Mapping[str, str]) -> Iterator[str]:
    """Sentence on the page."""
    if "report.html" in files:
        yield f"Open {files['report.html']} in a browser; it needs no network, and prints on paper."
