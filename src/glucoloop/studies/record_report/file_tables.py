"""Tables of a report for files: metrics, days, episodes, percentiles over the day, and groups of people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import polars as pl

from glucoloop.metrics.readings.episodes import BOUNDS_MG_DL, glucose_episodes
from glucoloop.metrics.readings.profile import by_day
from glucoloop.report.record_goals import Goals
from glucoloop.report.record_groups import Reported, ReportedGroup, ReportedRecord


def file_tables(
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
        "profile.csv": pl.concat([_profile_table(one) for one in reported]),
        **({"groups.csv": _groups_table(groups, goals)} if groups else {}),
    }


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
