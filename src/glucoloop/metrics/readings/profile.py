"""The ambulatory glucose profile: percentiles of glucose by time of day, and the metrics of days and times of day.

References
----------
R. M. Bergenstal et al., "Recommendations for standardizing glucose reporting and analysis to optimize clinical decision
making in diabetes: the ambulatory glucose profile", Diabetes Technol. Ther. 15(3), 198-211, 2013.
T. Battelino et al., Diabetes Care 42(8), 1593-1603, 2019: 5, 25, 50, 75 and 95 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop.metrics.readings.distribution import mean_and_variation, times_in_ranges
from glucoloop.metrics.readings.series import Floats, Readings
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

PERCENTILES: Final = (5, 25, 50, 75, 95)
STEP_MIN: Final = 15
_SHARES: Final = np.asarray(PERCENTILES) / 100.0
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

    Each reading counts for the time that it stands for; of several people it is of the readings of all.
    """
    bins = int(MIN_PER_DAY) // STEP_MIN
    times = np.concatenate([readings.time_of_day_min for readings in records])
    place = np.floor_divide(times, STEP_MIN).astype(np.int64)
    order = np.argsort(place, kind="stable")
    glucose = np.concatenate([readings.glucose_mg_dl for readings in records])[order]
    edges = np.searchsorted(place[order], np.arange(bins + 1))
    parts = [slice(edges[i], edges[i + 1]) for i in range(bins)]
    weights = _weights(records)
    weights = None if weights is None else weights[order]
    result, counts = [], []
    for i in range(bins):
        both = (parts[i - 1], parts[i])
        near = np.concatenate([glucose[part] for part in both])
        counts.append(float(near.size))
        near_weights = None if weights is None else np.concatenate([weights[part] for part in both])
        result.append(percentiles(near, near_weights))
    columns = np.asarray([*result, result[0]]).T
    t_min = STEP_MIN * np.arange(bins + 1, dtype=float)
    return DayProfile(t_min, dict(zip(PERCENTILES, columns, strict=True)), np.asarray([*counts, counts[0]]))


def _weights(records: Sequence[Readings]) -> Floats | None:
    """Time that each reading of several records stands for; None where all stand for the same."""
    every = [readings.weight_min for readings in records]
    if all(one is None for one in every) and len({readings.interval_min for readings in records}) == 1:
        return None
    return np.concatenate(
        [
            np.full(readings.t_min.size, readings.interval_min) if one is None else one
            for readings, one in zip(records, every, strict=True)
        ]
    )


def percentiles(values: Floats, weights: Floats | None) -> Floats:
    """`PERCENTILES` of values, NaN of none; with weights those of a value stand in the middle of its own.

    With equal weights they are those of NumPy: the first value is the percentile 0, and the last one 100.
    """
    if not values.size:
        return np.full(len(PERCENTILES), np.nan)
    if weights is None or np.all(weights == weights[0]):
        return _of_equal_weights(np.sort(values))
    order = np.argsort(values, kind="stable")
    middles = np.cumsum(weights[order]) - 0.5 * weights[order]
    at = (middles - middles[0]) / (middles[-1] - middles[0])
    return np.interp(_SHARES, at, values[order])


def _of_equal_weights(ordered: Floats) -> Floats:
    """`PERCENTILES` of values in their order, to the bit as `numpy.percentile` has them in four times the time."""
    at = _SHARES * (ordered.size - 1)
    low = at.astype(np.int64)
    beyond = at - low
    below, above = ordered[low], ordered[np.minimum(low + 1, ordered.size - 1)]
    step = above - below
    return np.where(beyond < 0.5, below + step * beyond, above - step * (1.0 - beyond))


def _of_part(readings: Readings | None) -> Mapping[str, float]:
    """Mean, variation and times in ranges of some of the readings; empty for fewer than two."""
    return {} if readings is None else {**mean_and_variation(readings), **times_in_ranges(readings)}


def by_day(readings: Readings) -> Iterator[tuple[int, Mapping[str, float]]]:
    """Numbers of each day with at least two readings, and the share of the day that they stand for."""
    of_a_day = MIN_PER_DAY / readings.interval_min
    days, begins = np.unique(readings.day, return_index=True)
    for day, low, high in zip(days.tolist(), begins, [*begins[1:], readings.day.size], strict=True):
        if high - low > 1:
            part = readings.between(low, high)
            active = min(100.0, 100.0 * (high - low) / of_a_day)
            if readings.weight_min is not None:
                active = min(100.0, 100.0 * float(readings.weight_min[low:high].sum()) / MIN_PER_DAY)
            yield day, {"readings": float(high - low), "active_pct": active, **_of_part(part)}


def by_time_of_day(readings: Readings) -> Iterator[tuple[str, Mapping[str, float]]]:
    """Numbers of each quarter of the day."""
    hour = readings.time_of_day_min / MIN_PER_H
    for name, (begins, ends) in PARTS_OF_DAY.items():
        yield name, _of_part(readings.only((hour >= begins) & (hour < ends)))
