"""Intervals of 95 % of means and shares over people, and of paired differences between the cases of a trial.

A mean, and a mean difference of a person with the same person, has the interval of Student's t. A share of the people
has that of E. B. Wilson, J. Am. Stat. Assoc. 22(158), 1927, 209-212; a difference of two shares of the same people that
of A. Agresti, Y. Min, "Simple improved confidence intervals for comparing matched proportions", Stat. Med. 24(5), 2005,
729-740. Each follows from sums, so that a million people take no more memory than a hundred; and with the means of
trials of 20 to 200 people Student's interval covers the truth more often than the percentiles of a bootstrap do.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import scipy.special

from glucoloop.trials.people import PeopleRows
from glucoloop.trials.quantiles import Moments

CONFIDENCE_PCT: Final = 95.0
FEWEST_DIFFERENT: Final = 10
"""Smallest number of people with a difference that has an interval; that of a few rare events would be too narrow."""
_MOST_PEOPLE: Final = 1e12


def mean_interval(moments: Moments) -> tuple[float, float]:
    """Interval of a mean, by Student's t; NaN for fewer than two numbers."""
    if moments.count < 2:
        return math.nan, math.nan
    half = _student(moments.count) * moments.sd / math.sqrt(moments.count)
    return moments.mean - half, moments.mean + half


def share_interval(count: int, total: int) -> tuple[float, float]:
    """Interval of a share in percent, by Wilson; NaN without people."""
    if not total:
        return math.nan, math.nan
    z2, share = _normal() ** 2, count / total
    centre, weight = share + z2 / (2.0 * total), 1.0 + z2 / total
    half = math.sqrt(z2 * (share * (1.0 - share) + z2 / (4.0 * total)) / total)
    return max(0.0, 100.0 * (centre - half) / weight), min(100.0, 100.0 * (centre + half) / weight)


def share_difference_interval(more: int, fewer: int, total: int) -> tuple[float, float]:
    """Interval of a difference of two shares of the same people in percentage points, by Agresti and Min.

    `more` people have it only in the second case, `fewer` only in the first; NaN without people.
    """
    if not total:
        return math.nan, math.nan
    people = total + 2
    difference = (more - fewer) / people
    half = _normal() * math.sqrt((more + fewer + 1.0) - (more - fewer) ** 2 / people) / people
    return max(-100.0, 100.0 * (difference - half)), min(100.0, 100.0 * (difference + half))


def people_for(half_width: float, sd: float) -> int | None:
    """Number of people for whom half of the interval of a mean is at most a width; None if it is not known."""
    if not math.isfinite(sd):
        return None
    least = (_normal() * sd / half_width) ** 2
    if least > _MOST_PEOPLE:
        return None
    people = max(2, math.ceil(least))
    while _student(people) * sd > half_width * math.sqrt(people):  # some two people more than by the normal law
        people += 1
    return people


def _student(people: int) -> float:
    return float(scipy.special.stdtrit(people - 1, 0.5 + CONFIDENCE_PCT / 200.0))


def _normal() -> float:
    return float(scipy.special.ndtri(0.5 + CONFIDENCE_PCT / 200.0))


class PairedDifferences:
    """Differences of one case from the first one, each person with the same person, from shards one at a time."""

    def __init__(self, limits_mg_dl: tuple[int, ...]) -> None:
        self._moments: dict[str, Moments] = {}
        self._different: dict[str, int] = {}
        self._shares = {f"{limit}_mg_dl": np.zeros(2, np.int64) for limit in limits_mg_dl}
        self._limits = limits_mg_dl
        self._people = 0

    def add(self, first: PeopleRows, other: PeopleRows, known: npt.NDArray[np.bool_]) -> None:
        """Include the people who are known in both cases, whose numbers are the same in both."""
        self._people += int(known.sum())
        for name in first.metrics.keys() & other.metrics.keys():
            difference = np.subtract(*(case.metrics[name][known].astype(np.float64) for case in (other, first)))
            difference = difference[np.isfinite(difference)]
            self._moments.setdefault(name, Moments()).add(difference)
            self._different[name] = self._different.get(name, 0) + int(np.count_nonzero(difference))
        low = [case.metrics["minimum_mg_dl"][known] for case in (first, other)]
        for limit, counts in zip(self._limits, self._shares.values(), strict=True):
            before, after = (minimum < limit for minimum in low)
            counts += (after & ~before).sum(), (before & ~after).sum()

    def plain(self) -> dict[str, Any]:
        """Differences as plain values: ``metrics``, and ``ever_below`` in percentage points of the people."""
        return {
            "people": self._people,
            "metrics": {name: self._metric(name) for name in sorted(self._moments)},
            "ever_below": {name: self._share(*counts.tolist()) for name, counts in self._shares.items()},
        }

    def _metric(self, name: str) -> dict[str, float | int]:
        moments, different = self._moments[name], self._different[name]
        enough = different >= min(FEWEST_DIFFERENT, moments.count)
        low, high = mean_interval(moments) if enough else (math.nan, math.nan)
        mean = moments.mean if moments.count else math.nan
        return {"mean": mean, "low": low, "high": high, "sd": moments.sd, "different_people": different}

    def _share(self, more: int, fewer: int) -> dict[str, float]:
        low, high = share_difference_interval(more, fewer, self._people)
        points = 100.0 * (more - fewer) / self._people if self._people else math.nan
        return {"mean": points, "low": low, "high": high}


@dataclasses.dataclass(frozen=True)
class Margin:
    """Largest difference of a metric that does not matter, in the metric's own unit."""

    metric: str
    value: float

    def verdict(self, difference: dict[str, float]) -> str:
        """Conclusion of a difference with its interval: ``equivalent``, ``higher``, ``lower`` or ``inconclusive``."""
        low, high = difference["low"], difference["high"]
        if low > -self.value and high < self.value:
            return "equivalent"
        if low > self.value:
            return "higher"
        return "lower" if high < -self.value else "inconclusive"
