"""Usual basal rate over time from the profiles of Nightscout and the treatments that switch between them.

As Nightscout's ``profilefunctions`` has it: the newest profile that has begun is in force, and within it the schedule
of the last switch that has not ended, or else the default one. AndroidAPS scales the schedule that a switch holds by a
percentage and moves it by whole hours.
"""

from __future__ import annotations

import itertools
import math
import zoneinfo
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Final, NamedTuple

import polars as pl

from glucoloop.records.clock import zone_named
from glucoloop.records.extract import finite, number_in
from glucoloop.records.file_text import FileText, json_of
from glucoloop.refusal import Refusal
from glucoloop.units import MG_DL_PER_MMOL_L

SWITCH: Final = "Profile Switch"
_MIN_PER_DAY: Final = 1440
_MS_PER_H: Final = 3_600_000.0
_NEVER: Final = (datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC))
_MAX_CHANGES: Final = 1_000_000
_MAX_MIN: Final = 1e7
"""Longest duration of a switch that is counted as one, some 19 years."""


def profiles_of(content: FileText) -> list[dict[str, Any]]:
    """Profiles that a file holds; none if it is no list of profiles."""
    items = content.items
    if items is None:
        return []
    return [item for item in items if isinstance(item, dict) and isinstance(item.get("store"), dict)]


class _Schedule(NamedTuple):
    """Basal rates of a day."""

    minutes: tuple[int, ...]
    rates_U_h: tuple[float, ...]
    zone: zoneinfo.ZoneInfo


class _Span(NamedTuple):
    """A schedule that is chosen from a moment on."""

    start: datetime
    end: datetime
    schedule: _Schedule | None
    factor: float = 1.0
    shift: timedelta = timedelta()

    def rate_U_h(self, at: datetime) -> float:
        """Rate at a moment; NaN if it is not known."""
        if self.schedule is None:
            return math.nan
        clock = (at - self.shift).astimezone(self.schedule.zone)
        place = bisect_right(self.schedule.minutes, clock.hour * 60 + clock.minute) - 1
        return self.factor * self.schedule.rates_U_h[place]  # before the first step, the last one of the day holds

    def steps(self, first: datetime, last: datetime) -> Iterator[datetime]:
        """Moments between two others at which the schedule may change."""
        if self.schedule is None:
            return
        day = (first - self.shift).astimezone(self.schedule.zone).date() - timedelta(days=1)
        while (midnight := datetime(day.year, day.month, day.day, tzinfo=self.schedule.zone)) <= last - self.shift:
            for minute in self.schedule.minutes:
                at = midnight.replace(hour=minute // 60, minute=minute % 60).astimezone(UTC) + self.shift
                if first < at <= last:
                    yield at
            day += timedelta(days=1)


def usual_rates(
    profiles: Sequence[Mapping[str, Any]],
    switches: Sequence[tuple[datetime, Mapping[str, Any]]],
    first: datetime,
    last: datetime,
    time_zone: str | None,
) -> list[tuple[datetime, float]]:
    """Moment (in UTC) and rate [U/h] of each change of the usual basal rate; NaN where it is not known.

    `switches` are the treatments `SWITCH` with their moments, and `time_zone` is that of a profile that names none.
    """
    documents = sorted(((_begin(profile), profile) for profile in profiles), key=lambda pair: pair[0])
    begins = [_NEVER[0], *(begin for begin, _ in documents)]
    stores: list[Mapping[str, Any]] = [{}, *(profile["store"] for _, profile in documents)]
    names = ["", *(str(profile.get("defaultProfile")) for _, profile in documents)]
    spans, chosen = [], list[_Span]()
    for begin, end, store, name in zip(begins, [*begins[1:], _NEVER[1]], stores, names, strict=True):
        spans.append(_Span(begin, end, _schedule(store.get(name), time_zone)))
    ordered = sorted(switches, key=lambda pair: pair[0])
    for span, store in zip(spans, stores, strict=True):  # a schedule that was edited later is another one from then
        of_span, end = list[_Span](), span.end
        for start, switch in reversed(ordered):
            whole = _switched(start, switch, store, time_zone)
            if whole is None:
                continue
            if start < end and whole.end > span.start:
                of_span.append(whole._replace(start=max(start, span.start), end=min(whole.end, end)))
            if whole.end == _NEVER[1]:  # no earlier one comes back after it
                end = min(end, start)
        chosen += reversed(of_span)
    every = [*spans, *chosen]

    def span_at(at: datetime) -> _Span | None:
        for among in (chosen, spans):
            active = [span for span in among if span.start <= at < span.end]
            if active:
                return active[-1]
        return None

    ends = {moment for span in every for moment in (span.start, span.end) if first < moment <= last}
    steps = itertools.chain.from_iterable(span.steps(max(first, span.start), min(last, span.end)) for span in every)
    moments = sorted({first, *ends, *itertools.islice(steps, _MAX_CHANGES + 1)})
    if len(moments) > _MAX_CHANGES:
        raise Refusal(
            f"by the profiles of Nightscout the basal rate would change more than {_MAX_CHANGES} times between "
            f"{first:%Y-%m-%d} and {last:%Y-%m-%d}; leave out the rows of a wrong year, or divide the file"
        )
    result: list[tuple[datetime, float]] = []
    for at in moments:
        active = span_at(at)
        rate = math.nan if active is None else active.rate_U_h(at)
        if not result or not (rate == result[-1][1] or (math.isnan(rate) and math.isnan(result[-1][1]))):
            result.append((at, rate))
    return result


def _switched(
    start: datetime, switch: Mapping[str, Any], store: Mapping[str, Any], time_zone: str | None
) -> _Span | None:
    """Span of a switch; None if nothing tells its schedule, and that before it goes on."""
    minutes = finite(switch.get("duration")) or 0.0
    end = start + timedelta(minutes=minutes) if 0.0 < minutes < _MAX_MIN else _NEVER[1]
    stored_profile = _profile_in(switch.get("profileJson"))
    schedule = _schedule(store.get(str(switch.get("profile"))), time_zone) or _schedule(stored_profile, time_zone)
    if schedule is None:
        return None
    percentage, hours = number_in(switch.get("percentage")) or 100.0, 0
    if stored_profile is not None and not switch.get("CircadianPercentageProfile"):
        hours = math.trunc(
            (finite(switch.get("timeshift")) or 0.0) / _MS_PER_H
        )  # AndroidAPS 3; Nightscout has no other
    factor = percentage / 100.0 if percentage > 0.0 else 1.0
    return _Span(start, end, schedule, factor, timedelta(hours=math.fmod(hours, 24)))


def _profile_in(text: object) -> object:
    """Schedules that a switch holds as a text in JSON; None if it holds none."""
    return json_of(text) if isinstance(text, str) else None


def _schedule(value: object, time_zone: str | None) -> _Schedule | None:
    """Basal rates of one entry of a store; None if it has none that are whole."""
    steps = value.get("basal") if isinstance(value, dict) else None
    if not isinstance(value, dict) or not isinstance(steps, list) or not steps:
        return None
    result = {}
    for step in steps:
        minute, rate = (_minute(step), _rate(step.get("value"))) if isinstance(step, dict) else (None, None)
        if minute is None or rate is None:
            return None
        result[minute] = rate
    minutes = tuple(sorted(result))
    zone = zoneinfo.ZoneInfo(zone_named(value.get("timezone")) or zone_named(time_zone) or "UTC")
    return _Schedule(minutes, tuple(result[minute] for minute in minutes), zone)


_NUMBERS: Final = {"basal": "basal", "carbratio": "carb_ratio", "sens": "correction"}
"""Lists of a schedule, and the names of their numbers in a therapy."""


def segments_of(content: object) -> dict[str, list[tuple[float, float]]] | None:
    """Minute and value of each segment of the newest profile, by name; None for what holds no profile.

    The numbers are ``basal`` [U/h], ``carb_ratio`` [g/U], ``correction`` [mg/dl/U] and ``target`` [mg/dl], the middle
    of the low and the high one.
    """
    documents = content if isinstance(content, list) else [content]
    profiles = [item for item in documents if isinstance(item, dict) and isinstance(item.get("store"), dict)]
    if not profiles:
        return None
    newest = max(profiles, key=_begin)
    schedule = _default_schedule(newest)
    if not isinstance(schedule, dict):
        return None
    units = str(schedule.get("units") or newest.get("units") or "mg/dl").lower()
    scale = MG_DL_PER_MMOL_L if units.startswith("mmol") else 1.0
    result = {}
    for key, name in _NUMBERS.items():
        steps = _steps(schedule.get(key))
        if steps:
            result[name] = [(minute, value * (scale if name == "correction" else 1.0)) for minute, value in steps]
    low, high = _steps(schedule.get("target_low")), _steps(schedule.get("target_high"))
    if low and high:
        minutes = sorted({minute for minute, _ in (*low, *high)})
        result["target"] = [(minute, scale * (_at(low, minute) + _at(high, minute)) / 2.0) for minute in minutes]
    return result or None


def document_of(segments: Mapping[str, Sequence[tuple[float, float]]]) -> dict[str, Any]:
    """Profile document of Nightscout with these segments, as `segments_of` reads them; without a date.

    Numbers have nine decimal places, which no change of their unit moves. Nightscout has temporary targets and
    overrides as treatments at a moment, and a profile has no place for them.
    """

    def steps(name: str) -> list[dict[str, Any]]:
        return [
            {
                "time": f"{int(minute) // 60:02d}:{int(minute) % 60:02d}",
                "value": round(value, 9),
                "timeAsSeconds": int(minute) * 60,
            }
            for minute, value in segments[name]
        ]

    schedule: dict[str, Any] = {key: steps(name) for key, name in _NUMBERS.items() if name in segments}
    if "target" in segments:
        schedule |= {"target_low": steps("target"), "target_high": steps("target")}
    return {"defaultProfile": "Default", "store": {"Default": {"units": "mg/dl", **schedule}}}


def _steps(value: object) -> list[tuple[float, float]]:
    """Minute and value of each step of a list in order; none if any of them is not whole."""
    steps = [
        (_minute(step), number_in(step.get("value")))
        for step in (value if isinstance(value, list) else ())
        if isinstance(step, dict)
    ]
    known = {float(minute): number for minute, number in steps if minute is not None and number is not None}
    return sorted(known.items()) if len(known) == len(steps) else []


def _at(steps: list[tuple[float, float]], minute: float) -> float:
    """Value of the step that holds at a minute of the day; before the first, the last one holds."""
    return next((value for start, value in reversed(steps) if start <= minute), steps[-1][1])


def _minute(step: Mapping[str, Any]) -> int | None:
    """Minute of the day of a step, from ``06:30`` or from seconds."""
    hours, colon, rest = str(step.get("time", "")).partition(":")
    if colon and hours.isdecimal() and rest[:2].isdecimal():
        minute = int(hours) * 60 + int(rest[:2])
    else:
        seconds = number_in(step.get("timeAsSeconds"))
        minute = -1 if seconds is None else int(seconds // 60)
    return minute if 0 <= minute < _MIN_PER_DAY else None


def _rate(value: object) -> float | None:
    """Rate of a step, which some programs write as a text."""
    number = number_in(value)
    return number if number is not None and 0.0 <= number <= 100.0 else None


def _default_schedule(profile: Mapping[str, Any]) -> Any:
    """Schedule that a profile names as its default one, or its first one; None if it has none."""
    store = profile["store"]
    return store.get(str(profile.get("defaultProfile"))) or next(iter(store.values()), None)


def zones_of(profiles: Sequence[Mapping[str, Any]]) -> list[str]:
    """Time zones that profiles tell of the person, the newest first."""
    zones = []
    for profile in sorted(profiles, key=_begin, reverse=True):
        chosen = _default_schedule(profile)
        zone = zone_named(chosen.get("timezone")) if isinstance(chosen, dict) else None
        if zone is not None:
            zones.append(zone)
    return list(dict.fromkeys(zones))


def fixed_zone(times: pl.DataFrame) -> str | None:
    """Zone of the offset from UTC that all times tell; None if they tell none, or several, or no whole hours."""
    offsets = times["utc_offset_min"].drop_nulls().unique()
    if len(offsets) != 1 or offsets[0] % 60:
        return None
    return zone_named(f"Etc/GMT{-int(offsets[0]) // 60:+d}")


def _begin(profile: Mapping[str, Any]) -> datetime:
    """Moment from which a profile is in force; the beginning of time where it does not tell."""
    milliseconds = finite(profile.get("mills"))
    text = profile.get("startDate") or profile.get("created_at")
    try:
        if isinstance(text, str):
            begin = datetime.fromisoformat(text)
            return (begin if begin.tzinfo else begin.replace(tzinfo=UTC)).astimezone(UTC)
        if milliseconds is not None:
            return datetime.fromtimestamp(milliseconds / 1000.0, UTC)
    except (ValueError, OverflowError, OSError):
        pass
    return _NEVER[0]
