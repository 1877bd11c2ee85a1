"""The hour that a clock repeats in autumn: which of its readings are of the second pass.

A file whose rows are in the order in which they were made tells it by a step back in time. One that is sorted by the
clock on the wall has both passes interleaved; there the course of glucose tells which reading follows which.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.records.extract import parts_of
from glucoloop.records.times import clock
from glucoloop.units import MIN_PER_H, S_PER_MIN

Floats = npt.NDArray[np.float64]

_MAX_STEPS_BACK: Final = 12
"""Number of steps back in time up to which the rows of a file are in the order of time."""
_CHANGES: Final = {4: (1, 7), 10: (25, 31), 11: (1, 7)}
_SUNDAY, _LAST_HOUR = 7, 3
"""Clocks go back in the first hours of a Sunday of these days of months, in all but a few countries."""
_MG_DL: Final = 5.0
"""Change of glucose from a reading to the next one that counts as much as half a step too late."""


def with_second_pass(frame: pl.DataFrame, zone: str | None) -> tuple[pl.DataFrame, list[str]]:
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
