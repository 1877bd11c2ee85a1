"""Metrics of the course of glucose over time: MAGE, MODD, CONGA and MAG, on a grid whose gaps stay gaps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from glucoloop.metrics.readings.series import Floats, Readings
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

_MAGE_STEP_MIN: Final = 5.0
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
    """MAGE: the mean amplitude of rises and falls of glucose by more than one standard deviation of all readings.

    Where a moving average of 25 min crosses one of 160 min, a rise or a fall is taken to begin; between two crossings
    the greatest or the least glucose itself is a peak or a nadir. Of peaks and nadirs, those that are not more than one
    standard deviation from the next are passed over. Gaps of more than 45 min part the record, and both ends of a part
    count as turns.

    References
    ----------
    F. J. Service et al., "Mean amplitude of glycemic excursions, a measure of diabetic instability", Diabetes 19(9),
    644-655, 1970.
    N. J. Fernandes, N. Nguyen, E. Chun, N. M. Punjabi, I. Gaynanova, "Open-source algorithm to calculate mean amplitude
    of glycemic excursions using short and long moving averages", J. Diabetes Sci. Technol. 16(2), 576-577, 2022.
    """
    threshold = float(readings.glucose_mg_dl.std(ddof=1))
    sizes = [
        np.abs(np.diff(turning_points(_extremes(segment.glucose_mg_dl), threshold)))
        for segment in readings.at_steps(_MAGE_STEP_MIN).segments()
        if segment.glucose_mg_dl.size > _LONG
    ]
    swings = np.concatenate(sizes) if sizes else np.empty(0)
    return {"mage_mg_dl": float(swings.mean()) if swings.size else np.nan}


def _trailing_mean(values: Floats, points: int) -> Floats:
    """Mean of each value and those before it, of as many as there are at the beginning."""
    sums = np.concatenate(([0.0], np.cumsum(values)))
    last = np.arange(1, values.size + 1)
    first = np.maximum(last - points, 0)
    return np.asarray((sums[last] - sums[first]) / (last - first))


def _extremes(glucose: Floats) -> Floats:
    """Peaks and nadirs: of each stretch between two crossings of the averages."""
    above = _trailing_mean(glucose, _SHORT) > _trailing_mean(glucose, _LONG)
    begins = np.flatnonzero(np.diff(above.astype(np.int8), prepend=-1))
    return np.where(above[begins], np.maximum.reduceat(glucose, begins), np.minimum.reduceat(glucose, begins))


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
