"""Metrics of the course of glucose over time: MAGE, MODD, CONGA and MAG, on a grid whose gaps stay gaps."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np

from glucoloop.metrics.readings.series import Floats, Readings
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

_MAGE_STEP_MIN: Final = 5.0
_MAGE_LONGEST_GAP_MIN: Final = 180.0
_SHORT, _LONG = 5, 32
"""Numbers of points of 5 min of the two moving averages, after Fernandes et al. (2022)."""


def lagged_differences(readings: Readings) -> Mapping[str, float]:
    """MODD, CONGA over 1 h and over 24 h, and MAG.

    ::

        MODD     = mean |G(t) - G(t - 24 h)|
        CONGA(n) = SD of G(t) - G(t - n h), with n - 1 as its denominator
        MAG      = mean |G(t) - G(t - one interval)| in an hour

    References
    ----------
    G. D. Molnar, W. F. Taylor, M. M. Ho, "Day-to-day variation of continuously monitored glycaemia: a further measure
    of diabetic instability", Diabetologia 8(5), 342-348, 1972.
    C. M. McDonnell, S. M. Donath, S. I. Vidmar, G. A. Werther, F. J. Cameron, "A novel approach to continuous glucose
    analysis utilizing glycemic variation", Diabetes Technol. Ther. 7(2), 253-263, 2005.
    J. Hermanides et al., "Glucose variability is associated with intensive care unit mortality", Crit. Care Med. 38(3),
    838-842, 2010: MAG.
    """
    grid = readings.grid
    hour, day, step = (grid.lagged(lag) for lag in (MIN_PER_H, MIN_PER_DAY, grid.step_min))

    def deviation(of: Floats) -> float:
        return float(of.std(ddof=1)) if of.size > 1 else np.nan

    def size(of: Floats) -> float:
        return float(np.abs(of).mean()) if of.size else np.nan

    return {
        "modd_mg_dl": size(day),
        "conga_1h_mg_dl": deviation(hour),
        "conga_24h_mg_dl": deviation(day),
        "mag_mg_dl_h": size(step) * MIN_PER_H / grid.step_min,
    }


def amplitude(readings: Readings) -> Mapping[str, float]:
    """MAGE: the mean amplitude of rises and falls of glucose by more than one standard deviation.

    Glucose is taken every 5 min, and what is missing is passed over; a gap of more than 3 h parts the record. In each
    part, from one crossing of a moving average of 5 points with one of 32 to the next, there is a peak where the first
    is the greater and a nadir where it is the less: the maximum, or minimum, glucose from the turn before to the end of
    the stretch. A swing of at most the standard deviation of the part is passed over. The mean rise and the mean fall
    of each part count by its duration, and MAGE is the mean of both.

    References
    ----------
    F. J. Service et al., "Mean amplitude of glycemic excursions, a measure of diabetic instability", Diabetes 19(9),
    644-655, 1970.
    N. J. Fernandes, N. Nguyen, E. Chun, N. M. Punjabi, I. Gaynanova, "Open-source algorithm to calculate mean amplitude
    of glycemic excursions using short and long moving averages", J. Diabetes Sci. Technol. 16(2), 576-577, 2022.
    P. A. Baghurst, "Calculating the mean amplitude of glycemic excursion from continuous glucose monitoring data: an
    automated algorithm", Diabetes Technol. Ther. 13(3), 296-302, 2011: the mean of rises and falls.
    """
    glucose = readings.at_steps(_MAGE_STEP_MIN).glucose_mg_dl
    known = np.flatnonzero(np.isfinite(glucose))
    parts = np.split(known, np.flatnonzero(np.diff(known) * _MAGE_STEP_MIN > _MAGE_LONGEST_GAP_MIN) + 1)
    rows = [
        (mean, part[-1] - part[0])
        for part in parts
        if part.size >= _LONG
        for mean in _swings(glucose[part])
        if np.isfinite(mean)
    ]
    if not rows:
        return {"mage_mg_dl": np.nan}
    means, durations = np.array(rows).T
    return {"mage_mg_dl": float(np.average(means, weights=durations))}


def _swings(glucose: Floats) -> tuple[float, float]:
    """Mean rise and mean fall by more than one standard deviation; NaN where there is none."""
    swings = np.diff(turning_points(_extremes(glucose), float(glucose.std(ddof=1))))
    rises, falls = swings[swings > 0.0], -swings[swings < 0.0]
    return (float(rises.mean()) if rises.size else np.nan, float(falls.mean()) if falls.size else np.nan)


def _moving_sum(values: Floats, points: int) -> Floats:
    """Sum of each value and those before it; before there are so many, the first of these sums."""
    sums = np.concatenate(([0.0], np.cumsum(values)))
    sums = sums[points:] - sums[:-points]
    return np.concatenate((np.full(points - 1, sums[0]), sums))


def _extremes(glucose: Floats) -> Floats:
    """Peaks and nadirs, one for each stretch between two crossings of the averages."""
    # sums and not means, whose rounding would make crossings of whole mg/dl that are equal
    above = _LONG * _moving_sum(glucose, _SHORT) > _SHORT * _moving_sum(glucose, _LONG)
    edges = [0, *(np.flatnonzero(above[1:] != above[:-1]) + 1).tolist(), glucose.size - 1]
    result, after = [], 0
    for begin, end in itertools.pairwise(edges):
        stretch = glucose[after : end + 1]
        if stretch.size:
            place = int(stretch.argmax() if above[begin] else stretch.argmin())
            result.append(stretch[place])
            after += place + 1
    return np.asarray(result)


def turning_points(values: Floats, threshold: float) -> Floats:
    """Values at which a course turns, if swings of at most a threshold are passed over; first and last by swings."""
    turns: list[float] = []
    low = high = values[0]
    rising: bool | None = None
    for value in values[1:].tolist():
        if rising is None:
            if value - low > threshold:
                turns, rising, high = [low], True, value
            elif high - value > threshold:
                turns, rising, low = [high], False, value
            else:
                low, high = min(low, value), max(high, value)
        elif rising:
            if value > high:
                high = value
            elif high - value > threshold:
                turns.append(high)
                rising, low = False, value
        elif value < low:
            low = value
        elif value - low > threshold:
            turns.append(low)
            rising, high = True, value
    if rising is not None:
        turns.append(high if rising else low)
    return np.asarray(turns)
