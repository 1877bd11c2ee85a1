"""The ambulatory glucose profile: percentiles of glucose by time of day, and the metrics of days and times of day.

References
----------
R. M. Bergenstal et al., "Recommendations for standardizing glucose reporting and analysis to optimize clinical decision
making in diabetes: the ambulatory glucose profile", Diabetes Technol. Ther. 15(3), 198-211, 2013.
T. Battelino et al., Diabetes Care 42(8), 1593-1603, 2019: 5, 25, 50, 75 and 95 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop.metrics.readings.distribution import mean_and_variation, times_in_ranges
from glucoloop.metrics.readings.series import Floats, Readings
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

PERCENTILES: Final = (5, 25, 50, 75, 95)
STEP_MIN: Final = 15
PARTS_OF_DAY: Final = {"0 to 6 h": (0, 6), "6 to 12 h": (6, 12), "12 to 18 h": (12, 18), "18 to 24 h": (18, 24)}


@dataclass(frozen=True)
class DayProfile:
    """Percentiles of glucose by time of day."""

    t_min: Floats
    """(97,) times of day from 0 to 24 h; the last is the first again."""
    percentiles_mg_dl: Mapping[int, Floats]
    """Each (97,), by percentage; NaN where nothing was read."""
    readings: Floats
    """(97,) numbers of readings that the percentiles are of."""


def day_profile(*records: Readings) -> DayProfile:
    """Percentiles, every 15 min, of all readings within 15 min of that time of day; nothing else is smoothed.

    Of several people it is of the readings of all, of which each counts alike.
    """
    bins = int(MIN_PER_DAY) // STEP_MIN
    times = np.concatenate([readings.time_of_day_min for readings in records])
    place = np.floor_divide(times, STEP_MIN).astype(np.int64)
    order = np.argsort(place, kind="stable")
    glucose = np.concatenate([readings.glucose_mg_dl for readings in records])[order]
    edges = np.searchsorted(place[order], np.arange(bins + 1))
    parts = [glucose[edges[i] : edges[i + 1]] for i in range(bins)]
    result, counts = [], []
    for i in range(bins + 1):
        near = np.concatenate((parts[i - 1], parts[i % bins]))
        counts.append(float(near.size))
        result.append(np.percentile(near, PERCENTILES) if near.size else np.full(len(PERCENTILES), np.nan))
    columns = np.asarray(result).T
    t_min = STEP_MIN * np.arange(bins + 1, dtype=float)
    return DayProfile(t_min, dict(zip(PERCENTILES, columns, strict=True)), np.asarray(counts))


def of_part(readings: Readings | None) -> Mapping[str, float]:
    """Mean, variation and times in ranges of some of the readings; empty for fewer than two."""
    return {} if readings is None else {**mean_and_variation(readings), **times_in_ranges(readings)}


def by_day(readings: Readings) -> Iterator[tuple[int, Mapping[str, float]]]:
    """Numbers of each day with at least two readings, and the share of its readings that are there."""
    of_a_day = MIN_PER_DAY / readings.interval_min
    days, begins = np.unique(readings.day, return_index=True)
    for day, low, high in zip(days.tolist(), begins, [*begins[1:], readings.day.size], strict=True):
        t_min, glucose = readings.t_min[low:high], readings.glucose_mg_dl[low:high]
        if high - low > 1:
            part = Readings(t_min, glucose, readings.interval_min, readings.day_0)
            active = min(100.0, 100.0 * (high - low) / of_a_day)
            yield day, {"readings": float(high - low), "active_pct": active, **of_part(part)}


def by_time_of_day(readings: Readings) -> Iterator[tuple[str, Mapping[str, float]]]:
    """Numbers of each quarter of the day."""
    hour = readings.time_of_day_min / MIN_PER_H
    for name, (begins, ends) in PARTS_OF_DAY.items():
        yield name, of_part(readings.only((hour >= begins) & (hour < ends)))
