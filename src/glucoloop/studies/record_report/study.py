"""Work of a report on records: reading, metrics, tables, and the page."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import polars as pl

from glucoloop.metrics.readings.catalogue import numbers_of
from glucoloop.metrics.readings.distribution import gri_zone
from glucoloop.metrics.readings.episodes import BOUNDS_MG_DL, glucose_episodes
from glucoloop.metrics.readings.given import GLUCAGON, day_sums, whole_days
from glucoloop.metrics.readings.profile import by_day
from glucoloop.metrics.readings.series import Readings
from glucoloop.records import FileRefusal
from glucoloop.refusal import Refusal
from glucoloop.reporting.columns import FittingTable, lines_table
from glucoloop.reporting.record_groups import (
    GOALS,
    Goals,
    Reported,
    ReportedGroup,
    ReportedRecord,
    groups_of,
    warnings,
    with_given,
)
from glucoloop.reporting.record_page import MAX_IN_FULL, SHORT_NUMBERS, number_columns, number_rows, record_page
from glucoloop.storage.results import Results
from glucoloop.studies.record_report import Period, RecordRequest, period_of
from glucoloop.studies.record_report.sources import NamedReadings, read, sources_of
from glucoloop.text import how_many, the_first
from glucoloop.units import MIN_PER_DAY

_MAX_ROWS: Final = 60
"""Largest number of records that the terminal has in rows; files have all."""
_MAX_REASONS: Final = 20
"""Largest number of records of which the page tells why they could not be read; report.json has all."""


class _Extra(NamedTuple):
    """Results from which pages and tables are made."""

    records: list[ReportedRecord]
    unread: list[tuple[str, str]]
    """Label of each record that could not be read, and a sentence with the names of its files."""


def amount(config: RecordRequest) -> int:
    """Number of files, and of folders of one person."""
    return len(sources_of(config))


def results_of(config: RecordRequest, progress: Callable[[int], None]) -> Results:
    """Read the records, and compute their metrics; one of a folder of people that cannot be read is named."""
    periods = [period_of(text) for text in config.periods] or [Period("")]
    records: list[ReportedRecord] = []
    unread: list[tuple[str, str]] = []
    not_read: list[dict[str, str]] = []
    for source in sources_of(config):
        try:
            own = [
                _reported(one, period, several=len(periods) > 1) for one in read(source, config) for period in periods
            ]
        except Refusal as error:
            if not source.group:
                raise
            unread.append((source.label, str(error)))
            not_read.append({"label": source.label, "why": error.why if isinstance(error, FileRefusal) else str(error)})
        else:
            records += own
        progress(1)
    if not records:
        raise Refusal(f"{unread[0][1]}{f' (and {len(unread) - 1} more)' if unread[1:] else ''}")
    records = with_given(records)
    groups = groups_of(records)
    plain = {
        "records": [_plain(record) for record in records],
        "groups": [_plain_group(group) for group in groups],
        "not_read": not_read,
        "complete": not not_read,
        "goals": config.goals,
        "notes": [*_on_unread(unread), *warnings(records)],
    }
    return Results(plain, _file_tables(records, groups, GOALS[config.goals]), _Extra(records, unread))


def _reported(one: NamedReadings, period: Period, *, several: bool) -> ReportedRecord:
    chosen = _within(one.readings, period, one.label)
    text = period.text.replace("/", " to ") if several else ""
    label = f"{one.label}: {text}" if text else one.label
    return ReportedRecord(label, chosen, numbers_of(chosen), one.notes, one.group, text, one.given)


def _on_unread(unread: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Sentence on the records that could not be read, without names of files."""
    if unread:
        labels = the_first([label for label, _ in unread])
        one, many = "record could not be read and is", "records could not be read and are"
        yield f"{how_many(len(unread), one, many)} in no number: {labels}."


def _within(readings: Readings, period: Period, label: str) -> Readings:
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


def _plain_group(group: ReportedGroup) -> dict[str, Any]:
    sufficient = sum(record.sufficient for record in group.records)
    spreads = {name: spread._asdict() for name, spread in group.spreads.items()}
    return {"label": group.label, "people": len(group.records), "sufficient": sufficient, **spreads}


def _plain(record: ReportedRecord) -> dict[str, Any]:
    about = {"label": record.label, "days_reported": record.dates, "sufficient": record.sufficient}
    return {**about, **record.numbers, "gri_zone": gri_zone(record.numbers["gri"]), "read": list(record.notes)}


def tables(config: RecordRequest, results: Results) -> Iterator[object]:
    """All metrics side by side, or the first ones of many records and of groups."""
    records: list[ReportedRecord] = results.extra.records
    if len(records) <= MAX_IN_FULL:
        yield lines_table("Metric", number_columns(records), number_rows(records))
    elif len(records) <= _MAX_ROWS:
        yield FittingTable(_rows_table("Record", ((one.label, one.numbers) for one in records)))
    if groups := groups_of(records):
        medians = ((f"{one.label}, {one.dates}", one.medians) for one in groups)
        yield FittingTable(_rows_table("Median of", medians))


def sentences(config: RecordRequest, results: Results) -> Iterator[str]:
    """Files that could not be read, by name: here alone, since names of files are in no result."""
    yield from (f"{label} was not read: {why}." for label, why in results.extra.unread)


def _rows_table(head: str, rows: Iterable[tuple[str, Mapping[str, float]]]) -> Any:
    """The first numbers of each record or group by its label."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(head)
    columns = [number for number in SHORT_NUMBERS if number.terminal]
    for number in columns:
        table.add_column(number.terminal, justify="right")
    for label, of in rows:
        table.add_row(Text(label), *(number.text(of[number.result]) for number in columns))
    return table


def files_of(config: RecordRequest, results: Results) -> dict[str, bytes]:
    """The page, and the figure."""
    from glucoloop.reporting.figure_files import figure_files
    from glucoloop.reporting.record_figure import plot_records

    records, goals = results.extra.records, GOALS[config.goals]
    why = [f"{one['label']}: {one['why']}." for one in results.plain["not_read"][:_MAX_REASONS]]
    page = record_page(records, goals, notes=[*_on_unread(results.extra.unread), *why])
    figure = plot_records(groups_of(records) or records, goals)
    return {"report.html": page.encode(), **figure_files("figure", figure)}


def next_steps(results: Results, files: Mapping[str, str]) -> Iterator[str]:
    """Sentence on the page."""
    if "report.html" in files:
        yield f"Open {files['report.html']} in a browser; it needs no network, and prints on paper."


def _file_tables(
    records: Sequence[ReportedRecord], groups: Sequence[ReportedGroup], goals: Goals
) -> dict[str, pl.DataFrame]:
    """Tables by the names of their files."""
    reported: list[Reported] = [*records, *groups]
    about = [{"record": one.label, "group": one.group or None, "period": one.period or None} for one in records]
    texts = dict.fromkeys(("record", "group", "period"), pl.String)
    metrics = pl.DataFrame(
        [{**a, **one.numbers} for a, one in zip(about, records, strict=True)], schema_overrides=texts
    )
    metrics = metrics.fill_nan(None)
    days = [
        {"record": one.label, "day": one.readings.date(day), **of, **given}
        for one in records
        for (day, of), given in zip(by_day(one.readings), _given_by_day(one), strict=True)
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
        "profile.csv": pl.concat([_profile_table(one) for one in reported]),
        **({"groups.csv": _groups_table(groups, goals)} if groups else {}),
    }


def _given_by_day(record: ReportedRecord) -> Iterator[dict[str, float]]:
    """Insulin, carbohydrate and glucagon of each day with numbers, where the records tell them."""
    whole = set(whole_days(record.readings))
    days = [day for day, _ in by_day(record.readings)]
    for day, sums in day_sums(record.given, days).items():
        known = {name: value if day in whole else math.nan for name, value in sums.items()}
        glucagon_ug = float(record.glucagon_ug.of_day(day).amount.sum())
        yield {
            **{name: known[name] for name, number in _BY_DAY.items() if number in record.numbers},
            **({"glucagon_ug": glucagon_ug} if GLUCAGON in record.numbers else {}),
        }


_BY_DAY: Final = {
    "insulin_U": "insulin_U_day",
    "basal_U": "basal_pct",
    "bolus_U": "bolus_U_day",
    "boluses": "boluses_day",
    "carbs_g": "carbs_g_day",
    "carb_entries": "carb_entries_day",
}
"""Sums of a day, and the number of the record without which they stand in no table."""


def _groups_table(groups: Sequence[ReportedGroup], goals: Goals) -> pl.DataFrame:
    """A row for each number of each group, with the share of the people who reach its goal."""

    def reached(group: ReportedGroup, name: str) -> float | None:
        goal = goals.goals.get(name)
        if goal is None:
            return None
        return 100.0 * sum(goal.reached(one.numbers[name]) for one in group.records) / len(group.records)

    rows = [
        {"group": group.label, "metric": name, **spread._asdict(), "goal_reached_pct": reached(group, name)}
        for group in groups
        for name, spread in group.spreads.items()
    ]
    return pl.DataFrame(rows, infer_schema_length=None).fill_nan(None)


_EPISODE_COLUMNS: Final = {
    "record": pl.String,
    "kind": pl.String,
    "begin": pl.String,
    "duration_min": pl.Float64,
    "extreme_mg_dl": pl.Float64,
    "extended": pl.Boolean,
    "nocturnal": pl.Boolean,
}


def _profile_table(record: Reported) -> pl.DataFrame:
    profile = record.profile
    curves = {f"glucose_{name}_pct_mg_dl": values for name, values in profile.percentiles_mg_dl.items()}
    columns = {"time_of_day_min": profile.t_min, "readings": profile.readings, **curves}
    return pl.DataFrame(columns).fill_nan(None).select(pl.lit(record.label).alias("record"), pl.all())
