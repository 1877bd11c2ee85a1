"""Self-contained page of records of glucose, in the order of the ambulatory glucose profile that clinics know.

References
----------
T. Battelino et al., "Clinical targets for continuous glucose monitoring data interpretation: recommendations from the
international consensus on time in range", Diabetes Care 42(8), 1593-1603, 2019: the ten numbers, the goals, the page.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from glucoloop.metrics.readings.catalogue import MEASURES
from glucoloop.metrics.readings.distribution import gri_zone
from glucoloop.metrics.readings.episodes import BOUNDS_MG_DL, GlucoseEpisode, glucose_episodes
from glucoloop.metrics.readings.profile import PERCENTILES, DayProfile, by_time_of_day, day_profile
from glucoloop.metrics.readings.series import LONGEST_FILLED_MIN, Floats, Readings
from glucoloop.metrics.settings import Result
from glucoloop.printable import how_many, percent, the_first
from glucoloop.report._style import RANGE_COLOURS
from glucoloop.report.charts import GLUCOSE, Panel, Plot
from glucoloop.report.columns import MetricRow, in_other_unit
from glucoloop.report.template import render
from glucoloop.shown_units import in_both_units, other_number
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

LEAST_DAYS: Final = 14.0
LEAST_ACTIVE_PCT: Final = 70.0
"""Least days, and least share of the readings, for which the consensus takes a record to stand for other days."""
MOST_IN_FULL: Final = 6
"""Largest number of records that each have their profile; of more there is a row for each."""
_MOST_DAYS: Final = {True: 28, False: 14}
"""Largest number of days that are drawn of each record, where it is the only one and where it is not."""
_MOST_POINTS: Final = {True: 288, False: 144}
"""Largest number of points of the curve of a day."""
_MOST_WARNED: Final = 3
_MOST_EPISODES: Final = 40
_AXIS_MG_DL: Final = (40.0, 300.0)
_LARGEST_MG_DL: Final = 400.0
_DAY_SIZE: Final = (240, 90)
_EPISODE_WORDS: Final = {
    kind: f"{'below' if bound < 100 else 'above'} {bound:g} mg/dl" for kind, bound in BOUNDS_MG_DL.items()
}


class Goal(NamedTuple):
    """Goal of the consensus for a number: less, or more, than a bound."""

    bound: float
    more: bool = False

    @property
    def text(self) -> str:
        """The goal in words."""
        return f"{'more' if self.more else 'less'} than {self.bound:g}\N{NO-BREAK SPACE}%"

    def reached(self, value: float) -> bool:
        """Whether a value is as aimed at."""
        return value > self.bound if self.more else value < self.bound


class GlucoseRange(NamedTuple):
    """A range of the bar of times in ranges."""

    name: str
    bounds: str
    result: str
    colour: str


@dataclass(frozen=True)
class Goals:
    """Ranges and goals of one kind of people."""

    name: str
    target_mg_dl: tuple[float, float]
    ranges: tuple[GlucoseRange, ...]
    """Ranges from the highest on; together they hold all readings."""
    goals: Mapping[str, Goal]


_COLOURS: Final = tuple(RANGE_COLOURS.values())
_RANGES: Final = (
    GlucoseRange("Very high", "above 250 mg/dl", "time_above_250_pct", _COLOURS[4]),
    GlucoseRange("High", "181 to 250 mg/dl", "time_180_250_pct", _COLOURS[3]),
    GlucoseRange("Target", "70 to 180 mg/dl", "time_70_180_pct", _COLOURS[2]),
    GlucoseRange("Low", "54 to 69 mg/dl", "time_54_70_pct", _COLOURS[1]),
    GlucoseRange("Very low", "below 54 mg/dl", "time_below_54_pct", _COLOURS[0]),
)
_PREGNANCY: Final = (
    GlucoseRange("High", "above 140 mg/dl", "time_above_140_pct", _COLOURS[3]),
    GlucoseRange("Target", "63 to 140 mg/dl", "time_63_140_pct", _COLOURS[2]),
    GlucoseRange("Low", "54 to 62 mg/dl", "time_54_63_pct", _COLOURS[1]),
    GlucoseRange("Very low", "below 54 mg/dl", "time_below_54_pct", _COLOURS[0]),
)
GOALS: Final = {
    "adult": Goals(
        "adults with type 1 or type 2 diabetes",
        (70.0, 180.0),
        _RANGES,
        {
            "time_above_250_pct": Goal(5.0),
            "time_above_180_pct": Goal(25.0),
            "time_70_180_pct": Goal(70.0, more=True),
            "time_below_70_pct": Goal(4.0),
            "time_below_54_pct": Goal(1.0),
        },
    ),
    "older": Goals(
        "older people or people at high risk",
        (70.0, 180.0),
        _RANGES,
        {
            "time_above_250_pct": Goal(10.0),
            "time_70_180_pct": Goal(50.0, more=True),
            "time_below_70_pct": Goal(1.0),
        },
    ),
    "pregnancy": Goals(
        "pregnancy with type 1 diabetes",
        (63.0, 140.0),
        _PREGNANCY,
        {
            "time_above_140_pct": Goal(25.0),
            "time_63_140_pct": Goal(70.0, more=True),
            "time_below_63_pct": Goal(4.0),
            "time_below_54_pct": Goal(1.0),
        },
    ),
}
"""Ranges and goals of the consensus of 2019."""
_SUMS: Final = {
    "time_above_180_pct": "All above 180 mg/dl",
    "time_below_70_pct": "All below 70 mg/dl",
    "time_below_63_pct": "All below 63 mg/dl",
}
_HIGHEST_CV_PCT: Final = 36.0


@dataclass(frozen=True)
class ReportedRecord:
    """One record, or one period of it."""

    label: str
    readings: Readings
    numbers: Mapping[str, float]
    notes: Sequence[str] = ()

    @property
    def dates(self) -> str:
        """First and last day."""
        first, last = (self.readings.date(int(self.readings.day[end])) for end in (0, -1))
        return first if first == last else f"{first} to {last}"

    @property
    def sufficient(self) -> bool:
        """Whether it is as long, in whole days, and as complete as the consensus asks for."""
        return round(self.numbers["days"]) >= LEAST_DAYS and self.numbers["active_pct"] >= LEAST_ACTIVE_PCT


def warnings(records: Sequence[ReportedRecord]) -> Iterator[str]:
    """Sentences on records that are too short or have too many gaps."""
    short = [record for record in records if not record.sufficient]
    asked = f"at least {LEAST_DAYS:g} days with {LEAST_ACTIVE_PCT:g} % of the readings"
    if len(short) > _MOST_WARNED:
        yield (
            f"{len(short)} of {len(records)} records are shorter than the consensus asks for, or have more gaps: "
            f"{the_first([record.label for record in short])}. It asks for {asked}, so the numbers of these may not "
            "stand for other days."
        )
        return
    for record in short:
        days, active = record.numbers["days"], percent(record.numbers["active_pct"])
        yield (
            f"{record.label} has {days:.1f} days with {active} of the readings. The consensus asks for {asked}, so "
            "these numbers may not stand for other days."
        )


def record_page(records: Sequence[ReportedRecord], goals: Goals, title: str = "Ambulatory glucose profile") -> str:
    """Records of glucose as a self-contained HTML page.

    For each record its sufficiency, mean, GMI and variation, times in ranges with goals, percentiles by time of day,
    days, episodes, and further metrics; several stand side by side first, and many in rows alone.

    Returns
    -------
    str
        HTML; labels and notes are shown as they are, whatever they hold.
    """
    full = len(records) <= MOST_IN_FULL
    return render(
        Path(__file__).with_name("templates") / "record.html",
        title,
        script=full,
        goals=goals,
        labels=[record.label for record in records],
        records=[_record(record, goals, alone=len(records) == 1) for record in records] if full else [],
        warnings=list(warnings(records)),
        heads=[heading for heading, _ in _short(records[0])],
        short=[[record.label, *(text for _, text in _short(record))] for record in records],
        rows=number_rows(records) if full else [],
        definitions=[(result.title.strip(), result.summary) for measure in MEASURES for result in measure.results],
    )


def number_rows(records: Sequence[ReportedRecord]) -> list[MetricRow]:
    """Rows with all metrics, a value for each record."""
    return [_row(measure.section, result, records) for measure in MEASURES for result in measure.results]


def _row(section: str, result: Result, records: Sequence[ReportedRecord]) -> MetricRow:
    values = [record.numbers[result.name] for record in records]
    texts = [result.text(value) for value in values]
    return MetricRow(section, result.title, result.unit, texts, in_other_unit(result, texts, values))


def _short(record: ReportedRecord) -> Iterator[tuple[str, Any]]:
    """Headings and texts of the few numbers of a record that has only a row."""
    of = record.numbers
    yield "Days", f"{of['days']:.1f}"
    yield "Time active", percent(of["active_pct"])
    mean = f"{of['mean_mg_dl']:.0f}"
    yield "Mean (mg/dl)", (mean, other_number(mean, of["mean_mg_dl"], "mg/dl"), "mg/dl")
    yield "GMI", f"{of['gmi_pct']:.1f} %"
    yield "CV", percent(of["cv_pct"])
    for heading, name in (
        ("Below 54 mg/dl", "time_below_54_pct"),
        ("Below 70 mg/dl", "time_below_70_pct"),
        ("70 to 180 mg/dl", "time_70_180_pct"),
        ("Above 180 mg/dl", "time_above_180_pct"),
        ("Above 250 mg/dl", "time_above_250_pct"),
    ):
        yield heading, percent(of[name])
    yield "GRI", f"{of['gri']:.1f}, {gri_zone(of['gri'])}"


def _record(record: ReportedRecord, goals: Goals, *, alone: bool) -> dict[str, Any]:
    readings = record.readings
    profile = day_profile(readings)
    found = {kind: glucose_episodes(readings, kind) for kind in BOUNDS_MG_DL}
    days = np.unique(readings.day)
    drawn = days[-_MOST_DAYS[alone] :]
    return {
        "of": record,
        "statistics": list(_statistics(record)),
        "bar": [(one, record.numbers[one.result]) for one in goals.ranges],
        "times": list(_times(record, goals)),
        "plot": _plot(record.label, profile, goals),
        "percentiles": list(_percentiles(profile)),
        "days": [_day(readings, int(day), goals, _MOST_POINTS[alone]) for day in drawn],
        "all_days": days.size,
        "weekday": _weekday(readings, int(drawn[0])),
        "parts_of_day": list(_parts_of_day(readings, goals)),
        "counts": [_count(kind, of, record.numbers["days"]) for kind, of in found.items()],
        "listed": _listed(readings, [*found["low"], *found["very_high"]]),
    }


def _statistics(record: ReportedRecord) -> Iterator[tuple[str, str, str, str, bool | None]]:
    """Name, value, value in the other unit, goal, and whether the goal is reached, of the first numbers of the page."""
    of = record.numbers
    yield "Days", f"{of['days']:.1f}", "", "14 or more", round(of["days"]) >= LEAST_DAYS
    yield "Time active", percent(of["active_pct"]), "", "70 % or more", of["active_pct"] >= LEAST_ACTIVE_PCT
    mean = f"{of['mean_mg_dl']:.0f}"
    yield "Mean glucose", f"{mean} mg/dl", f"{other_number(mean, of['mean_mg_dl'], 'mg/dl')} mmol/l", "", None
    yield "Glucose management indicator (GMI)", f"{of['gmi_pct']:.1f} %", "", "", None
    cv = of["cv_pct"]
    yield "Glucose variability (CV)", f"{cv:.1f} %", "", f"{_HIGHEST_CV_PCT:g} % or less", cv <= _HIGHEST_CV_PCT
    yield "Glycemia risk index (GRI)", f"{of['gri']:.1f}, zone {gri_zone(of['gri'])}", "", "", None


def _of_a_day(share_pct: float) -> str:
    """A share of the day as hours and minutes."""
    minutes = round(share_pct / 100.0 * MIN_PER_DAY)
    hours, rest = divmod(minutes, int(MIN_PER_H))
    return f"{hours} h {rest} min" if hours else f"{rest} min"


def _times(record: ReportedRecord, goals: Goals) -> Iterator[dict[str, Any]]:
    """Ranges from the highest on, with the sums that have goals of their own."""

    def line(name: str, bounds: str, result: str, colour: str = "") -> dict[str, Any]:
        value = record.numbers[result]
        goal = goals.goals.get(result)
        about = {"name": name, "bounds": bounds, "colour": colour, "share": percent(value), "time": _of_a_day(value)}
        return {**about, "goal": goal.text if goal else "", "reached": goal.reached(value) if goal else None}

    sums = [name for name in _SUMS if name in goals.goals]
    for one in goals.ranges:
        if one.name == "Very low":
            yield line(*one)
            yield from (line("", _SUMS[name], name) for name in sums if "below" in name)
        elif one.name == "High" and "time_above_180_pct" in sums:
            yield line(*one)
            yield line("", _SUMS["time_above_180_pct"], "time_above_180_pct")
        else:
            yield line(*one)


def highest_shown(profile: DayProfile) -> float:
    """Upper end of the axis of glucose: 300 mg/dl, or more where the upper curve needs it, up to 400 mg/dl."""
    highest = float(np.nan_to_num(profile.percentiles_mg_dl[95]).max())
    return min(_LARGEST_MG_DL, max(_AXIS_MG_DL[1], 1.05 * highest))


def _plot(label: str, profile: DayProfile, goals: Goals) -> Plot:
    """Percentiles over the day."""
    top = highest_shown(profile)
    panel = Panel(GLUCOSE, (_AXIS_MG_DL[0], top), height=330, band=goals.target_mg_dl)
    panel.rule(goals.target_mg_dl, 0, "target")
    panel.rule([54.0, 250.0], 1, "54 and 250 mg/dl")
    of = {percentage: np.clip(values, _AXIS_MG_DL[0], top) for percentage, values in profile.percentiles_mg_dl.items()}
    panel.area(profile.t_min, of[5], of[95], 0, "5 to 95 %")
    panel.area(profile.t_min, of[25], of[75], 0, "25 to 75 %")
    panel.line(profile.t_min, of[50], 0, name="median")
    return Plot(f"Glucose over the day, {label}", MIN_PER_DAY, [panel])


def _percentiles(profile: DayProfile) -> Iterator[list[Any]]:
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


def _weekday(readings: Readings, day: int) -> int:
    """Column of the first day that is drawn, 1 for Monday; of a simulated course 1."""
    if readings.day_0 is None:
        return 1
    return (readings.day_0 + dt.timedelta(days=day)).isoweekday()


def _day(readings: Readings, day: int, goals: Goals, most: int) -> dict[str, Any]:
    """Path of the curve of a day, and its time in the target range."""
    chosen = slice(*np.searchsorted(readings.day, [day, day + 1]))
    t, glucose = readings.t_min[chosen] - MIN_PER_DAY * day, readings.glucose_mg_dl[chosen]
    low, high = goals.target_mg_dl
    within = 100.0 * float(np.mean((glucose >= low) & (glucose <= high)))
    return {
        "name": readings.date(day),
        "within": percent(within),
        "path": _path(t, glucose, most),
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


def _count(kind: str, found: Sequence[GlucoseEpisode], days: float) -> list[Any]:
    mean = _minutes(sum(one.duration_min for one in found) / len(found)) if found else "none"
    per_week = f"{7.0 * len(found) / days:.1f}"
    more = [str(sum(one.extended for one in found)) if kind == "low" else "", str(sum(one.nocturnal for one in found))]
    return [_either(_EPISODE_WORDS[kind]), str(len(found)), per_week, mean, *more]


def _minutes(duration_min: float) -> str:
    return _of_a_day(100.0 * duration_min / MIN_PER_DAY)


def _listed(readings: Readings, found: Sequence[GlucoseEpisode]) -> dict[str, Any]:
    """Rows of the latest episodes, and the number of all."""
    latest = sorted(found, key=lambda one: one.t_min, reverse=True)
    rows = []
    for one in latest[:_MOST_EPISODES]:
        extreme = f"{one.extreme_mg_dl:.0f}"
        other = other_number(extreme, one.extreme_mg_dl, "mg/dl")
        cells = [_either(_EPISODE_WORDS[one.kind]), _minutes(one.duration_min), (extreme, other, "mg/dl")]
        rows.append([readings.moment(one.t_min), *cells])
    return {"rows": rows, "all": how_many(len(found), "episode")}
