"""Scores of an estimate of meals, by a threshold on the probability that a meal is being served.

A meal counts as *under way* from its beginning to 60 min after its end: a probability above the threshold in that time
is not a false alarm, and a rise above it later does not count as its detection. Times are on the leading axis, days
trail.
"""

from __future__ import annotations

from typing import Final

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.meals import Eaten
from glucoloop.meals.stomach import SERVED_G_PER_MIN
from glucoloop.units import MIN_PER_DAY

Array = npt.NDArray[np.float64]
Truths = npt.NDArray[np.bool_]

AFTERMATH_MIN: Final = 60.0
"""Time after a meal's end for which it is still under way, and after which its size is judged."""


def end_min(meals: Eaten) -> Array:
    """Time at which each meal has been served, ``(meals, days)``."""
    return np.asarray(meals.t_min + np.maximum(meals.carbs_g / SERVED_G_PER_MIN, meals.eating_min))


def followed_min(meals: Eaten, horizon_min: float) -> Array:
    """Time at which each meal's period ends, by the next meal or the end of the day, ``(meals, days)``."""
    after = np.full((1, meals.t_min.shape[1]), horizon_min)
    followed: Array = np.minimum(np.concatenate([meals.t_min[1:], after]), horizon_min)
    return followed


def in_order(meals: Eaten) -> Eaten:
    """Meals of days ``(meals, days)``, sorted by their beginning within each day."""
    order = np.argsort(meals.t_min, axis=0, kind="stable")
    ordered: Eaten = jax.tree.map(lambda part: np.take_along_axis(np.asarray(part), order, 0), meals)
    return ordered


def under_way(meals: Eaten, t_min: Array) -> Truths:
    """Whether a meal is being served, or was within the last 60 min, ``(samples, days)``."""
    t = t_min[:, None, None]
    way: Truths = np.any((meals.t_min <= t) & (t <= end_min(meals) + AFTERMATH_MIN), axis=1)
    return way


def delays_min(eating: Array, t_min: Array, meals: Eaten, threshold: float, horizon_min: float) -> tuple[Array, Truths]:
    """Delay of the first sample after each meal's beginning at which the probability is above the threshold.

    It is ``(meals, days)``, with NaN for a meal that was missed, or that began with the probability above the threshold
    already, which is told beside it. Meals of a day are in their order.
    """
    above = eating > threshold
    last = np.minimum(end_min(meals) + AFTERMATH_MIN, followed_min(meals, horizon_min))
    delay, already = np.full(meals.t_min.shape, np.nan), np.zeros(meals.t_min.shape, bool)
    for row, (begin, until) in enumerate(zip(meals.t_min, last, strict=True)):
        before = np.searchsorted(t_min, begin, side="right") - 1
        already[row] = above[before, np.arange(begin.size)]
        found = above & (t_min[:, None] > begin) & (t_min[:, None] <= until)
        first = t_min[np.argmax(found, axis=0)] - begin
        delay[row] = np.where(found.any(axis=0) & ~already[row], first, np.nan)
    return delay, already


def false_alarms(eating: Array, quiet: Truths, threshold: float) -> int:
    """Number of rises of the probability above the threshold that begin in a quiet time, ``(samples, days)``."""
    above = eating > threshold
    before = np.concatenate([np.zeros_like(above[:1]), above[:-1]])
    return int((above & ~before & quiet).sum())


def days_of(quiet: Truths, sample_time_min: float) -> float:
    """Length of the quiet time, in days."""
    return float(quiet.sum() * sample_time_min / MIN_PER_DAY)


def told_at(values: Array, t_min: Array, at_min: Array, since_min: Array, until_min: Array) -> Array:
    """Estimate for each meal at the first sample from a time on, all ``(meals, days)``.

    It is NaN where that sample is before the detection, until when an estimate is about the meal before, or not before
    the end of the meal's period.
    """
    sample = np.searchsorted(t_min, at_min, side="left")
    kept = np.minimum(sample, t_min.size - 1)
    at_sample = np.take_along_axis(values, kept, axis=0)
    heard = (sample < t_min.size) & (t_min[kept] >= since_min) & (t_min[kept] < until_min)
    return np.where(heard, at_sample, np.nan)
