"""Groups of people on the page of records: the numbers of the consensus as they are spread over the people."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from glucoloop.display_units import other_number
from glucoloop.metrics.readings.people import PeopleSpread
from glucoloop.report.profile_plot import percentile_rows, profile_plot
from glucoloop.report.record_goals import HIGHEST_CV_PCT, MIN_ACTIVE_PCT, MIN_DAYS, Goals
from glucoloop.report.record_groups import ReportedGroup
from glucoloop.text import NOT_AVAILABLE, percent


class _Number(NamedTuple):
    """A number of a group: name on the page, name of the result, text of a value, and its goal, if it has one."""

    name: str
    result: str
    text: Callable[[float], str]
    goal: str = ""
    reached: Callable[[float], bool] | None = None
    colour: str = ""


def group_parts(group: ReportedGroup, goals: Goals) -> dict[str, Any]:
    """Values of a group for the template."""
    return {
        "of": group,
        "numbers": [_shown(number, group) for number in _numbers(goals)],
        "sufficient": sum(record.sufficient for record in group.records),
        "bar": [(one, group.numbers[one.result]) for one in goals.ranges],
        "plot": profile_plot(group.label, group.profile, goals),
        "percentiles": list(percentile_rows(group.profile)),
    }


def groups_beside(groups: Sequence[ReportedGroup], goals: Goals) -> list[list[Any]]:
    """Rows with the median and the quartiles of each number in each group."""
    return [[number.name, *(_quartiles(number, group) for group in groups)] for number in _numbers(goals)]


def _numbers(goals: Goals) -> Iterator[_Number]:
    """Numbers of the consensus in its order."""
    yield _Number("Days", "days", lambda value: f"{value:.1f}", "14 or more", lambda value: round(value) >= MIN_DAYS)
    yield _Number("Time active", "active_pct", percent, "70 % or more", lambda value: value >= MIN_ACTIVE_PCT)
    yield _Number("Mean glucose (mg/dl)", "mean_mg_dl", lambda value: f"{value:.0f}")
    yield _Number("GMI", "gmi_pct", lambda value: f"{value:.1f} %")
    cv_goal = f"{HIGHEST_CV_PCT:g} % or less"
    yield _Number("CV", "cv_pct", lambda value: f"{value:.1f} %", cv_goal, lambda value: value <= HIGHEST_CV_PCT)
    yield _Number("Glycemia risk index (GRI)", "gri", lambda value: f"{value:.1f}")
    for one in goals.lines:
        name = f"{one.name}: {one.bounds}" if one.name else one.bounds
        goal = goals.goals.get(one.result)
        text, reached = (goal.text, goal.reached) if goal else ("", None)
        yield _Number(name, one.result, percent, text, reached, one.colour)


def _shown(number: _Number, group: ReportedGroup) -> dict[str, Any]:
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
