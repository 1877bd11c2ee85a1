"""Self-contained page of records of glucose, in the order of the ambulatory glucose profile that clinics know.

References
----------
T. Battelino et al., "Clinical targets for continuous glucose monitoring data interpretation: recommendations from the
international consensus on time in range", Diabetes Care 42(8), 1593-1603, 2019: the ten numbers, the goals, the page.
"""

from __future__ import annotations

import datetime as dt
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from glucoloop.display_units import in_both_units, other_number
from glucoloop.metrics.metric import Result
from glucoloop.metrics.readings.catalogue import MEASURES, PeopleSpread
from glucoloop.metrics.readings.distribution import gri_zone
from glucoloop.metrics.readings.episodes import BOUNDS_MG_DL, GlucoseEpisode, glucose_episodes
from glucoloop.metrics.readings.given import GIVEN_RESULTS, SECTION
from glucoloop.metrics.readings.profile import PERCENTILES, DayProfile, by_time_of_day
from glucoloop.metrics.readings.series import LONGEST_FILLED_MIN, Floats, Readings
from glucoloop.reporting.charts import GLUCOSE, Panel, Plot, PlottedQuantity
from glucoloop.reporting.columns import MetricRow, in_other_unit
from glucoloop.reporting.record_groups import (
    HIGHEST_CV_PCT,
    MIN_ACTIVE_PCT,
    MIN_DAYS,
    Goals,
    Reported,
    ReportedGroup,
    ReportedRecord,
    groups_of,
    warnings,
)
from glucoloop.reporting.template import render
from glucoloop.text import NOT_AVAILABLE, how_many, percent
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

MAX_IN_FULL: Final = 6
"""Largest number of records that each have their profile; of more there is a row for each."""
_MAX_DAYS: Final = {True: 28, False: 14}
"""Largest number of days that are drawn of each record, where it is the only one and where it is not."""
_MAX_POINTS: Final = {True: 288, False: 144}
"""Largest number of points of the curve of a day."""
_MAX_EPISODES: Final = 40
_DAY_SIZE: Final = (240, 90)
_EPISODE_WORDS: Final = {
    kind: f"{'below' if bound < 100 else 'above'} {bound:g} mg/dl" for kind, bound in BOUNDS_MG_DL.items()
}


def record_page(
    records: Sequence[ReportedRecord],
    goals: Goals,
    *,
    notes: Sequence[str] = (),
    title: str = "Ambulatory glucose profile",
) -> str:
    """Records of glucose as a self-contained HTML page.

    For each record its sufficiency, mean, GMI and variation, times in ranges with goals, percentiles by time of day,
    days, episodes, and further metrics; several stand side by side first, and many in rows alone. Groups of people have
    the same numbers as a spread over the people, and the percentiles of all readings.

    Parameters
    ----------
    records : sequence of ReportedRecord
        Records in the order in which they stand.
    goals : Goals
        Ranges and goals.
    notes : sequence of str
        Sentences that stand first, beside those on records that are too short.

    Returns
    -------
    str
        HTML; labels and notes are shown as they are, whatever they hold.
    """
    full = len(records) <= MAX_IN_FULL
    groups = groups_of(records)
    full_groups = groups[:MAX_IN_FULL]
    beside = full_groups if len(groups) > 1 else records if full and not groups else ()
    return render(
        Path(__file__).with_name("templates") / "record.html",
        title,
        script=full or bool(groups),
        goals=goals,
        labels=[record.label for record in records],
        records=[_record(record, goals, alone=len(records) == 1) for record in records] if full else [],
        groups=[_group_parts(group, goals) for group in full_groups],
        more_groups=len(groups) - len(full_groups),
        group_heads=[f"{group.label}, {group.dates}" for group in full_groups],
        group_rows=_groups_beside(full_groups, goals) if len(groups) > 1 else [],
        medians=medians_plot(beside, goals) if len(beside) > 1 else None,
        median_labels=[one.label for one in beside],
        warnings=[*notes, *warnings(records)],
        heads=[number.heading for number in SHORT_NUMBERS],
        short=[[record.label, *(_short_cell(number, record) for number in SHORT_NUMBERS)] for record in records],
        columns=number_columns(records),
        rows=number_rows(records) if full else [],
        definitions=[
            *((result.title.strip(), result.summary) for measure in MEASURES for result in measure.results),
            *((result.title.strip(), result.summary) for result in _known(records)),
        ],
    )


_GLUCAGON_OF_HOUR: Final = PlottedQuantity("Glucagon", "ug/h", "", 0.0, 0.01, 1)


def number_columns(records: Sequence[ReportedRecord]) -> list[str]:
    """Headings of the values of `number_rows`: of two records also their difference."""
    labels = [record.label for record in records]
    return ["Value"] if len(records) == 1 else [*labels, "Difference"] if len(records) == 2 else labels


def number_rows(records: Sequence[ReportedRecord]) -> list[MetricRow]:
    """Rows with all metrics, a value for each record; of two records also the second less the first."""
    rows = [_row(measure.section, result, records) for measure in MEASURES for result in measure.results]
    return [*rows, *(_row(SECTION, result, records) for result in _known(records))]


def _known(records: Sequence[ReportedRecord]) -> list[Result]:
    """Numbers of insulin, carbohydrate and glucagon that the records have."""
    return [result for result in GIVEN_RESULTS if result.name in records[0].numbers]


def _row(section: str, result: Result, records: Sequence[ReportedRecord]) -> MetricRow:
    values = [record.numbers[result.name] for record in records]
    texts = [result.text(value) for value in values]
    if len(records) == 2:
        values.append(values[1] - values[0])
        texts.append(f"{'+' if values[2] > 0.0 else ''}{result.text(values[2])}")
    return MetricRow(section, result.title, result.unit, texts, in_other_unit(result, texts, values))


def _one_decimal(value: float) -> str:
    return f"{value:.1f}"


def _one_decimal_pct(value: float) -> str:
    return f"{value:.1f} %"


class _ShortNumber(NamedTuple):
    """A number of a record that has only a row."""

    heading: str
    """Heading on the page."""
    terminal: str
    """Heading on the terminal, which leaves a number without one out."""
    result: str
    text: Callable[[float], str]


SHORT_NUMBERS: Final = (
    _ShortNumber("Days", "Days", "days", _one_decimal),
    _ShortNumber("Time active", "Active", "active_pct", percent),
    _ShortNumber("Mean (mg/dl)", "", "mean_mg_dl", "{:.0f}".format),
    _ShortNumber("GMI", "GMI", "gmi_pct", _one_decimal_pct),
    _ShortNumber("CV", "CV", "cv_pct", percent),
    _ShortNumber("Below 54 mg/dl", "< 54", "time_below_54_pct", percent),
    _ShortNumber("Below 70 mg/dl", "< 70", "time_below_70_pct", percent),
    _ShortNumber("70 to 180 mg/dl", "70-180", "time_70_180_pct", percent),
    _ShortNumber("Above 180 mg/dl", "> 180", "time_above_180_pct", percent),
    _ShortNumber("Above 250 mg/dl", "> 250", "time_above_250_pct", percent),
    _ShortNumber("GRI", "GRI", "gri", _one_decimal),
)
"""The few numbers of a record that has only a row, on the page and on the terminal."""


def _short_cell(number: _ShortNumber, record: ReportedRecord) -> Any:
    """Text of a number; of glucose in both units, and of the index with its zone."""
    value = record.numbers[number.result]
    text = number.text(value)
    if number.result == "mean_mg_dl":
        return text, other_number(text, value, "mg/dl"), "mg/dl"
    return f"{text}, {gri_zone(value)}" if number.result == "gri" else text


def _record(record: ReportedRecord, goals: Goals, *, alone: bool) -> dict[str, Any]:
    readings = record.readings
    results = {kind: glucose_episodes(readings, kind) for kind in BOUNDS_MG_DL}
    days = np.unique(readings.day)
    latest = days[-_MAX_DAYS[alone] :]
    return {
        "of": record,
        "statistics": list(_statistics(record, goals)),
        "bar": [(one, record.numbers[one.result]) for one in goals.ranges],
        "times": list(_times(record, goals)),
        "plot": _profile_plot(record, [record], goals),
        "percentiles": list(_percentile_rows(record.profile)),
        "given": _given_rows(record),
        "days": [_day(record, int(day), goals, _MAX_POINTS[alone]) for day in latest],
        "all_days": days.size,
        "weekday": _weekday(readings, int(latest[0])),
        "parts_of_day": list(_parts_of_day(readings, goals)),
        "counts": [_count(kind, of, record.numbers["days"]) for kind, of in results.items()],
        "listed": _listed(readings, [*results["low"], *results["very_high"]]),
    }


def _statistics(record: ReportedRecord, goals: Goals) -> Iterator[tuple[str, str, str, str, bool | None]]:
    """Name, value, value in the other unit, goal, and whether the goal is reached, of the first numbers of the page."""
    for number in itertools.takewhile(lambda number: number.title, _numbers(goals)):
        value = record.numbers[number.result]
        text, other = number.text(value), ""
        if number.result == "mean_mg_dl":
            text, other = f"{text} mg/dl", f"{other_number(text, value, 'mg/dl')} mmol/l"
        elif number.result == "gri":
            text = f"{text}, zone {gri_zone(value)}"
        yield number.title, text, other, number.goal, number.reached(value) if number.reached else None


def _given_rows(record: ReportedRecord) -> list[list[str]]:
    """Name and value with its unit of insulin, carbohydrate and glucagon."""
    values = ((result, record.numbers[result.name]) for result in _known([record]))
    return [
        [result.title.strip(), f"{result.text(value)} {result.unit}".strip()]
        for result, value in values
        if math.isfinite(value)
    ]


def _of_a_day(share_pct: float) -> str:
    """A share of the day as hours and minutes."""
    minutes = round(share_pct / 100.0 * MIN_PER_DAY)
    hours, rest = divmod(minutes, int(MIN_PER_H))
    return f"{hours} h {rest} min" if hours else f"{rest} min"


def _times(record: ReportedRecord, goals: Goals) -> Iterator[dict[str, Any]]:
    """Ranges from the highest on, with the sums that have goals of their own."""

    def line(name: str, bounds: str, result: str, colour: str) -> dict[str, Any]:
        value = record.numbers[result]
        goal = goals.goals.get(result)
        about = {"name": name, "bounds": bounds, "colour": colour, "share": percent(value), "time": _of_a_day(value)}
        return {**about, "goal": goal.text if goal else "", "reached": goal.reached(value) if goal else None}

    for one in goals.lines:
        yield line(*one)


def _weekday(readings: Readings, day: int) -> int:
    """Column of the first day that is drawn, 1 for Monday; of a simulated course 1."""
    if readings.day_0 is None:
        return 1
    return (readings.day_0 + dt.timedelta(days=day)).isoweekday()


def _day(record: ReportedRecord, day: int, goals: Goals, most: int) -> dict[str, Any]:
    """Path of the curve of a day, its time in the target range, and its glucagon."""
    readings = record.readings
    glucagon = record.glucagon_ug.of_day(day)
    chosen = slice(*np.searchsorted(readings.day, [day, day + 1]))
    t, glucose = readings.clock_min[chosen] - MIN_PER_DAY * day, readings.glucose_mg_dl[chosen]
    low, high = goals.target_mg_dl
    within = 100.0 * readings.between(chosen.start, chosen.stop).mean((glucose >= low) & (glucose <= high))
    return {
        "name": readings.date(day),
        "within": percent(within),
        "path": _path(t, glucose, most),
        "glucagon": f"{glucagon.amount.sum():.0f} ug of glucagon" if glucagon.amount.size else "",
        "doses": "".join(f"M{_DAY_SIZE[0] * (t_min / MIN_PER_DAY - day):.1f} 0v9" for t_min in glucagon.clock_min),
        "band": (_up(high), _up(low) - _up(high)),
        "size": _DAY_SIZE,
    }


def _up(glucose: float) -> float:
    low, high = _AXIS_MG_DL[0], _LARGEST_MG_DL
    return round(_DAY_SIZE[1] * (high - min(max(glucose, low), high)) / (high - low), 1)


def _path(t_min: Floats, glucose: Floats, most: int) -> str:
    """Path of a curve with gaps, of about as many points as are allowed."""
    every = max(1, round(t_min.size / most))
    t, values = t_min[::every], glucose[::every]
    starts = np.diff(t, prepend=-np.inf) > max(LONGEST_FILLED_MIN, every)
    x = _DAY_SIZE[0] * t / MIN_PER_DAY
    points = zip(starts.tolist(), x.tolist(), values.tolist(), strict=True)
    return "".join(
        f"{'M' if new else 'L'}{right:.1f} {_up(value)}{'h0.1' if new else ''}" for new, right, value in points
    )


def _parts_of_day(readings: Readings, goals: Goals) -> Iterator[list[Any]]:
    for name, of in by_time_of_day(readings):
        if not of:
            yield [name, *["none"] * (2 + len(goals.ranges))]
            continue
        mean = f"{of['mean_mg_dl']:.0f}"
        cells = [(mean, other_number(mean, of["mean_mg_dl"], "mg/dl"), "mg/dl"), percent(of["cv_pct"])]
        yield [name, *cells, *(percent(of[one.result]) for one in goals.ranges)]


def _either(text: str) -> tuple[str, str, str]:
    """A text in mg/dl, the same in mmol/l, and the unit of the first."""
    other = "".join(other if unit else same for unit, same, other in in_both_units(text))
    return text, other, "mg/dl"


def _count(kind: str, results: Sequence[GlucoseEpisode], days: float) -> list[Any]:
    mean = _minutes(sum(one.duration_min for one in results) / len(results)) if results else "none"
    per_week = f"{7.0 * len(results) / days:.1f}"
    more = [
        str(sum(one.extended for one in results)) if kind == "low" else "",
        str(sum(one.nocturnal for one in results)),
    ]
    return [_either(_EPISODE_WORDS[kind]), str(len(results)), per_week, mean, *more]


def _minutes(duration_min: float) -> str:
    return _of_a_day(100.0 * duration_min / MIN_PER_DAY)


def _listed(readings: Readings, results: Sequence[GlucoseEpisode]) -> dict[str, Any]:
    """Rows of the latest episodes, and the number of all."""
    latest = sorted(results, key=lambda one: one.t_min, reverse=True)
    rows = []
    for one in latest[:_MAX_EPISODES]:
        extreme = f"{one.extreme_mg_dl:.0f}"
        other = other_number(extreme, one.extreme_mg_dl, "mg/dl")
        cells = [_either(_EPISODE_WORDS[one.kind]), _minutes(one.duration_min), (extreme, other, "mg/dl")]
        rows.append([readings.moment(one.t_min), *cells])
    return {"rows": rows, "all": how_many(len(results), "episode")}


class _Number(NamedTuple):
    """A number of the consensus for a record or a group, with its goal, if it has one."""

    title: str
    """Name of a number of a record; empty where the page shows it otherwise."""
    name: str
    """Name of a number of a group."""
    result: str
    text: Callable[[float], str]
    goal: str = ""
    reached: Callable[[float], bool] | None = None
    colour: str = ""


def _group_parts(group: ReportedGroup, goals: Goals) -> dict[str, Any]:
    """Values of a group for the template."""
    return {
        "of": group,
        "numbers": [_group_number(number, group) for number in _numbers(goals)],
        "sufficient": sum(record.sufficient for record in group.records),
        "bar": [(one, group.numbers[one.result]) for one in goals.ranges],
        "plot": _profile_plot(group, group.records, goals),
        "percentiles": list(_percentile_rows(group.profile)),
    }


def _groups_beside(groups: Sequence[ReportedGroup], goals: Goals) -> list[list[Any]]:
    """Rows with the median and the quartiles of each number in each group."""
    return [[number.name, *(_quartiles(number, group) for group in groups)] for number in _numbers(goals)]


def _numbers(goals: Goals) -> Iterator[_Number]:
    """Numbers of the consensus in its order."""
    yield _Number("Days", "Days", "days", _one_decimal, "14 or more", lambda value: round(value) >= MIN_DAYS)
    active = "Time active"
    yield _Number(active, active, "active_pct", percent, "70 % or more", lambda value: value >= MIN_ACTIVE_PCT)
    yield _Number("Mean glucose", "Mean glucose (mg/dl)", "mean_mg_dl", "{:.0f}".format)
    yield _Number("Glucose management indicator (GMI)", "GMI", "gmi_pct", _one_decimal_pct)
    cv, cv_goal = "Glucose variability (CV)", f"{HIGHEST_CV_PCT:g} % or less"
    yield _Number(cv, "CV", "cv_pct", _one_decimal_pct, cv_goal, lambda value: value <= HIGHEST_CV_PCT)
    gri = "Glycemia risk index (GRI)"
    yield _Number(gri, gri, "gri", _one_decimal)
    for one in goals.lines:
        name = f"{one.name}: {one.bounds}" if one.name else one.bounds
        goal = goals.goals.get(one.result)
        text, reached = (goal.text, goal.reached) if goal else ("", None)
        yield _Number("", name, one.result, percent, text, reached, one.colour)


def _group_number(number: _Number, group: ReportedGroup) -> dict[str, Any]:
    values = [record.numbers[number.result] for record in group.records]
    reached = number.reached
    return {
        "name": number.name,
        "colour": number.colour,
        "mean": _in_units(number, "{}", [group.spreads[number.result].mean]),
        "quartiles": _quartiles(number, group),
        "goal": number.goal,
        "reached": percent(100.0 * sum(map(reached, values)) / len(values)) if reached else "",
    }


def _quartiles(number: _Number, group: ReportedGroup) -> Any:
    """Median with the quartiles in brackets."""
    of: PeopleSpread = group.spreads[number.result]
    if not of.people:
        return NOT_AVAILABLE
    return _in_units(number, "{} ({} to {})", [of.median, of.p25, of.p75])


def _in_units(number: _Number, pattern: str, values: Sequence[float]) -> Any:
    """A text, or for glucose one in both units with the first of them."""
    texts = [number.text(value) for value in values]
    if not number.result.endswith("_mg_dl"):
        return pattern.format(*texts)
    others = [other_number(text, value, "mg/dl") for text, value in zip(texts, values, strict=True)]
    return pattern.format(*texts), pattern.format(*others), "mg/dl"


_AXIS_MG_DL: Final = (40.0, 300.0)
_LARGEST_MG_DL: Final = 400.0
"""Ends of the axis of glucose where no curve needs more, and its largest end."""


def top_of_axis_mg_dl(profile: DayProfile) -> float:
    """Upper end of the axis of glucose: 300 mg/dl, or more where the upper curve needs it, up to 400 mg/dl."""
    highest = float(np.nan_to_num(profile.percentiles_mg_dl[95]).max())
    return min(_LARGEST_MG_DL, max(_AXIS_MG_DL[1], 1.05 * highest))


def _profile_plot(one: Reported, records: Sequence[ReportedRecord], goals: Goals) -> Plot:
    """Plot of percentiles over the day, and of glucagon in each hour where there is any."""
    profile = one.profile
    top = top_of_axis_mg_dl(profile)
    panel = _panel(top, goals)
    of = {percentage: np.clip(values, _AXIS_MG_DL[0], top) for percentage, values in profile.percentiles_mg_dl.items()}
    panel.area(profile.t_min, of[5], of[95], 0, "5 to 95 %")
    panel.area(profile.t_min, of[25], of[75], 0, "25 to 75 %")
    panel.line(profile.t_min, of[50], 0, name="median")
    panels = [panel]
    glucagon = one.glucagon_ug
    if glucagon.amount.size:
        edges = MIN_PER_H * np.arange(25.0)
        sums, _ = np.histogram(glucagon.clock_min % MIN_PER_DAY, edges, weights=glucagon.amount)
        of_a_day = sums / sum(record.numbers["days"] for record in records)
        panels.append(Panel(_GLUCAGON_OF_HOUR, (0.0, 1.05 * float(of_a_day.max())), height=110))
        panels[1].line(edges, of_a_day, 0, name="mean")
    return Plot(f"Glucose over the day, {one.label}", MIN_PER_DAY, panels)


def medians_plot(reported: Sequence[Reported], goals: Goals) -> Plot:
    """Medians of several records or groups over the day in one plot; of two also the middle halves."""
    top = max(top_of_axis_mg_dl(one.profile) for one in reported)
    panel = _panel(top, goals)
    for place, one in enumerate(reported):
        of = {at: np.clip(values, _AXIS_MG_DL[0], top) for at, values in one.profile.percentiles_mg_dl.items()}
        if len(reported) == 2:
            panel.area(one.profile.t_min, of[25], of[75], place, f"{one.label}, 25 to 75 %")
        panel.line(one.profile.t_min, of[50], place, name=f"{one.label}, median")
    return Plot("Medians over the day side by side", MIN_PER_DAY, [panel])


def _panel(top: float, goals: Goals) -> Panel:
    panel = Panel(GLUCOSE, (_AXIS_MG_DL[0], top), height=330, band=goals.target_mg_dl)
    panel.rule(goals.target_mg_dl, 0, "target")
    panel.rule([54.0, 250.0], 1, "54 and 250 mg/dl")
    return panel


def _percentile_rows(profile: DayProfile) -> Iterator[list[Any]]:
    """Rows of the percentiles every hour."""
    for place in range(0, profile.t_min.size - 1, int(MIN_PER_H) // 15):
        row: list[Any] = [_clock(profile.t_min[place])]
        for percentage in PERCENTILES:
            value = float(profile.percentiles_mg_dl[percentage][place])
            text = f"{value:.0f}" if math.isfinite(value) else "none"
            row.append((text, other_number(text, value, "mg/dl"), "mg/dl"))
        yield row


def _clock(t_min: float) -> str:
    return f"{int(t_min) // 60 % 24:02d}:{int(t_min) % 60:02d}"
