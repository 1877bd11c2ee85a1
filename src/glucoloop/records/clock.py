"""One clock for all files of a person: instants in UTC where they can be known, and the time on the wall beside them.

A file tells times on the wall, or in UTC with or without the offset of the wall. One zone holds for all files: the one
that the user gives, or else the one that a profile or a device tells. Without a zone the offsets that some times tell
hold for the others too. What contradicts itself is asked about.

The hour that a clock repeats in autumn is there twice. A file whose rows are in the order in which they were made tells
the second pass by a step back in time; in one that is sorted by the clock on the wall both passes are interleaved, and
the course of glucose tells which reading follows which.
"""

from __future__ import annotations

import functools
import math
import zoneinfo
from collections.abc import Sequence
from datetime import datetime
from typing import Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.records.answers import Answers
from glucoloop.records.extract import parts_of
from glucoloop.records.times import clock
from glucoloop.refusal import Refusal
from glucoloop.text import the_first
from glucoloop.units import MIN_PER_H, S_PER_MIN

Floats = npt.NDArray[np.float64]

_UTC: Final = ("UTC", "GMT", "ETC/UTC", "ETC/GMT", "ETC/UCT", "UCT", "ZULU", "ETC/ZULU", "ETC/UNIVERSAL")
"""Zones that programs write where nobody chose one."""
_MOST_AT_ODDS: Final = 0.05
"""Largest share of offsets that may be at odds with the others, as for some hours after a journey."""
_FEW: Final = 12
_ASK: Final = "say the time zone of the person with time_zone (--time-zone)"


def zone_named(name: object) -> str | None:
    """Name of a time zone as it is registered, also for one in other letters, as ``ETC/GMT+5``; None if it is none."""
    if not isinstance(name, str) or not name:
        return None
    name = _registered().get(name.strip().casefold(), name)
    try:
        zoneinfo.ZoneInfo(name)
        pl.select(pl.lit(datetime(2000, 1, 1)).dt.replace_time_zone(name))
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError, pl.exceptions.PolarsError):
        return None
    return name


@functools.cache
def _registered() -> dict[str, str]:
    """Names of time zones by themselves in small letters."""
    return {name.casefold(): name for name in zoneinfo.available_timezones()}


def on_one_clock(frame: pl.DataFrame, zones: Sequence[str], answers: Answers) -> tuple[pl.DataFrame, list[str]]:
    """Rows with the time on the wall, its offset, and whether they are of a repeated hour's second pass; and notes.

    `zones` are the time zones that files tell. Refusal where they, or offsets, contradict each other.
    """
    notes: list[str] = []
    frame = frame.with_columns(_told="utc_offset_min")
    zone = answers.time_zone or _zone_told(frame, zones, notes)
    if frame["in_utc"].any():
        frame = _in_zone(frame, zone, notes) if zone else _by_offsets(frame, notes)
    frame, more = _with_second_pass(frame, zone)
    frame, settled = _wall_offsets(frame, zone)
    return frame.drop("_told"), [*notes, *more, *settled]


def _offset(there: pl.Expr) -> pl.Expr:
    return (there.dt.base_utc_offset() + there.dt.dst_offset()).dt.total_minutes().cast(pl.Int32)


def _offset_in(zone: str) -> pl.Expr:
    """Offset of a zone at times in UTC."""
    return _offset(pl.col("time").dt.replace_time_zone("UTC").dt.convert_time_zone(zone))


def _zone_told(frame: pl.DataFrame, zones: Sequence[str], notes: list[str]) -> str | None:
    """The zone that the files tell; None if they tell none."""
    known = list(dict.fromkeys(filter(None, map(zone_named, zones))))
    told = frame.filter("in_utc", pl.col("_told").is_not_null(), pl.col("time").is_not_null())
    chosen = [zone for zone in known if zone.upper() not in _UTC]
    if not chosen and (told["_told"] != 0).any():
        return None
    chosen = chosen or known[:1]
    if len(chosen) > 1 and frame.height:
        span = frame.select(pl.col("time").drop_nulls().unique())
        offsets = [span.select(_offset_in(zone)).to_series() for zone in chosen]
        if any(not other.equals(offsets[0]) for other in offsets[1:]):
            raise Refusal(f"its files tell different time zones, {the_first(chosen)}", _ASK)
    if not chosen:
        return None
    zone = chosen[0]
    at_odds = told.filter(pl.col("_told") != _offset_in(zone))
    if at_odds.height > max(_FEW, _MOST_AT_ODDS * told.height):
        other = at_odds["_told"].mode()[0]
        raise Refusal(
            f"it tells the time zone {zone}, and {at_odds.height} of its times tell another offset from UTC, as "
            f"{other} min",
            _ASK,
        )
    notes.append(f"{zone} is the time zone that the files tell; it holds for all times.")
    return zone


def _in_zone(frame: pl.DataFrame, zone: str, notes: list[str]) -> pl.DataFrame:
    """Rows whose times in UTC are those on the wall of a zone."""
    notes.append(f"Times in UTC were brought to {zone}.")
    other = frame.filter("in_utc", pl.col("_told") != _offset_in(zone)).height
    if other:
        notes.append(f"{other} times tell another offset from UTC than {zone} has; the zone was taken.")
    there = pl.col("time").dt.replace_time_zone("UTC").dt.convert_time_zone(zone)
    return frame.with_columns(
        time=pl.when("in_utc").then(there.dt.replace_time_zone(None)).otherwise("time"),
        utc_offset_min=pl.when("in_utc").then(_offset(there)).otherwise("utc_offset_min"),
    )


def _by_offsets(frame: pl.DataFrame, notes: list[str]) -> pl.DataFrame:
    """Rows whose times in UTC are those on the wall by the offsets that they, or their neighbours in time, tell."""
    told = pl.col("in_utc") & pl.col("_told").is_not_null() & pl.col("time").is_not_null()
    known = frame.filter(told).select("time", "_told").sort("time")
    if not known.height:
        if frame.filter(~pl.col("in_utc"), pl.col("utc_offset_min").is_null()).height:
            raise Refusal("some of its times are in UTC and others on the clock on the wall", _ASK)
        files = "the file tells" if frame["file"].n_unique() == 1 else "the files tell"
        notes.append(
            f"Times are in UTC, for {files} no other; the time zone of the person brings them to the time on the wall."
        )
        shift: pl.Expr = pl.lit(0, pl.Int32)
        return frame.with_columns(utc_offset_min=pl.when("in_utc").then(shift).otherwise("utc_offset_min"))
    known = _without_odds(known, notes)
    at, offsets = known["time"].to_physical().to_numpy(), known["_told"].to_numpy()
    moments = frame["time"].to_physical().fill_null(0).to_numpy()
    after = np.searchsorted(at, moments).clip(1, max(1, at.size - 1))
    if at.size > 1:
        nearest = np.where(moments - at[after - 1] <= at[after] - moments, after - 1, after)
    else:
        nearest = np.zeros(moments.size, int)
    of_nearest = pl.Series("_nearest", offsets[nearest], dtype=pl.Int32)
    filled = int((frame["in_utc"] & frame["_told"].is_null() & frame["time"].is_not_null()).sum())
    if filled:
        notes.append(
            f"{filled} times are in UTC and tell no offset of the clock on the wall; that of the nearest time that "
            "tells one was taken."
        )
    frame = frame.with_columns(of_nearest)
    constant = known["_told"].n_unique() == 1
    offset = (
        pl.when("in_utc")
        .then("_nearest")
        .when(pl.lit(constant) & pl.col("time").is_not_null())
        .then(pl.coalesce("utc_offset_min", "_nearest"))
        .otherwise("utc_offset_min")
    )
    shift = pl.duration(minutes=pl.when("in_utc").then("_nearest").otherwise(0).cast(pl.Int64), time_unit="us")
    return frame.with_columns(time=pl.col("time") + shift, utc_offset_min=offset).drop("_nearest")


def _without_odds(known: pl.DataFrame, notes: list[str]) -> pl.DataFrame:
    """Offsets of which each hour has one; Refusal where two clocks run beside each other."""
    hour = known.with_columns(hour=pl.col("time").dt.truncate("1h"))
    usual = hour.group_by("hour").agg(usual=pl.col("_told").mode().sort().last(), kinds=pl.col("_told").n_unique())
    hour = hour.join(usual, on="hour", how="left", maintain_order="left")
    odd = hour.filter(pl.col("_told") != pl.col("usual"))
    if odd.height > max(_FEW, _MOST_AT_ODDS * hour.height):
        pair = sorted({*hour.filter(pl.col("kinds") > 1)["_told"].unique()})
        raise Refusal(
            f"its times tell different offsets from UTC at the same time, {the_first([f'{one} min' for one in pair])}",
            _ASK,
        )
    if odd.height:
        notes.append(
            f"{odd.height} times tell another offset from UTC than others of the same hour; "
            "the more common one was taken."
        )
    return hour.select("time", _told="usual")


def _wall_offsets(frame: pl.DataFrame, zone: str | None) -> tuple[pl.DataFrame, list[str]]:
    """Rows on the clock on the wall with the offset that a zone has then."""
    unknown = pl.col("utc_offset_min").is_null() & pl.col("time").is_not_null()
    if zone is None or not frame.select(unknown.any()).item():
        return frame, []
    notes = []
    early, late = (
        pl.col("time").dt.replace_time_zone(zone, ambiguous=which, non_existent="null")
        for which in ("earliest", "latest")
    )
    frame = frame.with_columns(_early=_offset(early), _late=_offset(late))
    repeated = pl.col("_early") != pl.col("_late")
    settled = pl.when("second_pass").then("_late").otherwise("_early")
    two_passes = pl.col("second_pass").any().over(pl.col("time").dt.date()) & pl.col("glucose_mg_dl").is_not_null()
    frame = frame.with_columns(_open=unknown & repeated & ~two_passes, _gone=unknown & pl.col("_early").is_null())
    open_rows, gone = int(frame["_open"].fill_null(False).sum()), int(frame["_gone"].fill_null(False).sum())
    frame = frame.with_columns(
        utc_offset_min=pl.when(pl.col("_open")).then(None).when(unknown).then(settled).otherwise("utc_offset_min")
    )
    if open_rows:
        notes.append(
            f"{open_rows} rows lie in an hour that {zone} has twice, and nothing says in which of the two: their "
            "offset from UTC is left unknown."
        )
    if gone:
        notes.append(f"{gone} rows lie in an hour that {zone} skips; their offset from UTC is left unknown.")
    return frame.drop("_early", "_late", "_open", "_gone"), notes


_MAX_STEPS_BACK: Final = 12
"""Number of steps back in time up to which the rows of a file are in the order of time."""
_CHANGES: Final = {4: (1, 7), 10: (25, 31), 11: (1, 7)}
_SUNDAY, _LAST_HOUR = 7, 3
"""Clocks go back in the first hours of a Sunday of these days of months, in all but a few countries."""
_MG_DL: Final = 5.0
"""Change of glucose from a reading to the next one that counts as much as half a step too late."""


def _with_second_pass(frame: pl.DataFrame, zone: str | None) -> tuple[pl.DataFrame, list[str]]:
    """Rows marked as of a second pass, and notes; `zone` says which hours are repeated, where it is known."""
    frame = frame.with_columns(second_pass=pl.lit(False))
    read = pl.col("glucose_mg_dl").is_not_null() & pl.col("time").is_not_null() & pl.col("utc_offset_min").is_null()
    marked: list[list[int]] = []
    interleaved = 0
    for rows in parts_of(frame.with_row_index("_at").filter(read), "file", "source", "kind"):
        steps = rows["time"].diff().dt.total_minutes()
        if (steps < 0).sum() > (steps > 0).sum():
            rows = rows.reverse()
            steps = rows["time"].diff().dt.total_minutes()
        if (steps < 0).sum() > _MAX_STEPS_BACK:
            continue
        back = ((steps <= -30) & (steps >= -90)).arg_true()
        for place in back:
            before = rows["time"][place - 1]
            after = rows.slice(place).filter(pl.col("time").cum_max() <= before)
            copies = after.join(rows.slice(0, place), on=["time", "glucose_mg_dl"], how="semi").height
            if 2 * copies <= after.height:  # else it is a part of the file that is there twice
                marked.append(after["_at"].to_list())
        if not len(back) and not (steps < 0).any():
            passes = _interleaved(rows, zone)
            interleaved += len(passes)
            marked += passes
    if not marked:
        return frame, []
    places = [place for part in marked for place in part]
    second = pl.Series(places, dtype=pl.UInt32)
    frame = frame.with_columns(second_pass=pl.int_range(pl.len(), dtype=pl.UInt32).is_in(second.implode()))
    first = clock(frame.filter("second_pass")["time"].min())
    notes = [
        f"The clock went back in {len(marked)} place{'s' if len(marked) > 1 else ''}, first at {first}: "
        f"{len(places)} readings of a repeated hour are kept beside those of the first pass."
    ]
    if interleaved:
        notes.append("The rows are sorted by the clock on the wall; the course of glucose told the two passes apart.")
    return frame, notes


def _interleaved(rows: pl.DataFrame, zone: str | None) -> list[list[int]]:
    """Places of the readings of the second pass in each hour that rows in the order of the wall clock have twice."""
    steps = rows["time"].diff().dt.total_seconds() / S_PER_MIN
    step = steps.filter(steps > 0).median()
    if step is None:
        return []
    usual = MIN_PER_H / float(step)  # type: ignore[arg-type]
    hours = rows.group_by(hour=pl.col("time").dt.truncate("1h")).agg(count=pl.len())
    full = hours.filter(pl.col("count") >= max(1.5 * usual, 2.0), pl.col("count") <= 2.0 * usual + 1.0)
    if zone is not None:
        early, late = (
            pl.col("hour").dt.replace_time_zone(zone, ambiguous=which, non_existent="null")
            for which in ("earliest", "latest")
        )
        full = full.filter(
            early.dt.dst_offset() + early.dt.base_utc_offset() != late.dt.dst_offset() + late.dt.base_utc_offset()
        )
    else:
        full = full.filter(
            pl.any_horizontal(
                (pl.col("hour").dt.month() == month) & pl.col("hour").dt.day().is_between(*days)
                for month, days in _CHANGES.items()
            ),
            pl.col("hour").dt.weekday() == _SUNDAY,
            pl.col("hour").dt.hour() <= _LAST_HOUR,
        )
        beside = [
            full.join(hours, left_on=pl.col("hour").dt.offset_by(by), right_on="hour", how="left")
            for by in ("-1h", "1h")
        ]
        full = full.filter(*(one["count_right"].fill_null(0) < 1.5 * usual for one in beside))
    if full.height > _MAX_STEPS_BACK:
        return []
    minutes = (rows["time"].to_physical() / (1e6 * S_PER_MIN)).to_numpy()
    glucose, places = rows["glucose_mg_dl"].to_numpy(), rows["_at"].to_list()
    result = []
    for hour in full["hour"].sort():
        inside = (rows["time"].dt.truncate("1h") == hour).arg_true().to_numpy()
        low, high = int(inside[0]), int(inside[-1]) + 1
        second = _second_pass(minutes[low:high], glucose[low:high], *_ends(glucose, low, high), float(step))  # type: ignore[arg-type]
        if second:
            result.append([places[low + place] for place in second])
    return result


def _ends(glucose: Floats, low: int, high: int) -> tuple[float, float]:
    """Reading before an hour and the one after it; NaN where there is none."""
    return (glucose[low - 1] if low else math.nan, glucose[high] if high < glucose.size else math.nan)


def _second_pass(t_min: Floats, glucose: Floats, before: float, after: float, step: float) -> list[int]:
    """Readings of the second of two passes of an hour, so that the course over both changes least.

    Each reading in the order of the wall continues one of the passes; the second begins where the first ends.
    """

    def cost(change: float, minutes: float) -> float:
        late = minutes / step - 1.0
        return (0.0 if math.isnan(change) else (change / _MG_DL) ** 2) + (2.0 * late) ** 2

    best: tuple[float, list[int]] = (math.inf, [])
    count = t_min.size
    for first_of_second in range(min(count, 4)):
        # states: last reading of each pass, with the cost and the readings of the second pass
        states: dict[tuple[int, int], tuple[float, list[int]]] = {(-1, -1): (0.0, [])}
        for place in range(count):
            later: dict[tuple[int, int], tuple[float, list[int]]] = {}
            for (last_1, last_2), (sofar, second) in states.items():
                options = []
                if place != first_of_second:
                    change = glucose[place] - (before if last_1 < 0 else glucose[last_1])
                    minutes = step if last_1 < 0 else t_min[place] - t_min[last_1]
                    options.append(((place, last_2), sofar + cost(change, minutes), second))
                if place == first_of_second:
                    options.append(((last_1, place), sofar, [*second, place]))
                elif last_2 >= 0:
                    change, minutes = glucose[place] - glucose[last_2], t_min[place] - t_min[last_2]
                    options.append(((last_1, place), sofar + cost(change, minutes), [*second, place]))
                for key, total, of_second in options:
                    if total < later.get(key, (math.inf, []))[0]:
                        later[key] = (total, of_second)
            states = later
        for (last_1, last_2), (sofar, second) in states.items():
            if last_1 < 0 or last_2 < 0:
                continue
            between = t_min[first_of_second] + MIN_PER_H - t_min[last_1]
            whole = (
                sofar + cost(glucose[first_of_second] - glucose[last_1], between) + cost(after - glucose[last_2], step)
            )
            if whole < best[0]:
                best = (whole, second)
    return best[1]
