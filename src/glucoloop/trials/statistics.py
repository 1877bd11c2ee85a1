"""Statistics of many people: quantiles in memory that does not grow with their number, and intervals of 95 %.

Glucose and insulin over time are counted in bins, whose edges are evenly spaced from 0. Counts of any number of people
take the same room, add exactly, and give quantiles to the width of a bin.

Quantiles of a metric are exact. Few numbers are gathered and sorted. Of many, those of the ranks are searched digit by
digit: finite floating-point numbers are in the order of whole numbers made of their bits, so a reading that counts the
numbers by the first digit of that whole number gives the first digit of each rank, the next reading counts by the next
digit those that begin alike, and the last one leaves the number itself.

A mean, and a mean difference of a person with the same person, has the interval of Student's t. A share of the people
has that of E. B. Wilson, J. Am. Stat. Assoc. 22(158), 1927, 209-212; a difference of two shares of the same people that
of A. Agresti, Y. Min, "Simple improved confidence intervals for comparing matched proportions", Stat. Med. 24(5), 2005,
729-740. Each follows from sums, so that a million people take no more memory than a hundred; and with the means of
trials of 20 to 200 people Student's interval covers the truth more often than the percentiles of a bootstrap do.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop._lazy_jax import scipy
from glucoloop.trials.people import PeopleRows

Floats = npt.NDArray[np.float64]
Parts = Callable[[], Iterable[Sequence[Floats]]]
"""Function that reads the parts again from the first one; each holds the numbers of every column."""
_HIGHEST_GLUCOSE_MG_DL: Final = 600
GLUCOSE_BIN_MG_DL: Final = 1.0
INSULIN_BIN_MU_MIN: Final = 0.25
BAND_QUANTILES: Final = (0.01, 0.05, 0.10, 0.25, 0.50, 0.75, 0.90, 0.95, 0.99)
"""Quantiles of glucose and insulin over time."""
_TIMES_MG_DL: Final = {
    "time_below_54_pct": (0, 54),
    "time_below_70_pct": (0, 70),
    "time_70_180_pct": (70, 180),
    "time_above_180_pct": (180, _HIGHEST_GLUCOSE_MG_DL),
    "time_above_250_pct": (250, _HIGHEST_GLUCOSE_MG_DL),
}
"""Glucose from and to which the samples of a time in a range are counted."""
_BITS: Final = 11
"""Bits of a digit: six readings for 64 bits."""
_FEW: Final = 8192
"""Largest number of values in a column that are gathered and sorted."""
_DIGIT: Final = np.uint64((1 << _BITS) - 1)
_SIGN: Final = np.uint64(1 << 63)


def glucose_edges() -> Floats:
    """Edges of the bins of glucose, mg/dl; values beyond them are counted in the outermost bins."""
    return GLUCOSE_BIN_MG_DL * np.arange(_HIGHEST_GLUCOSE_MG_DL / GLUCOSE_BIN_MG_DL + 1, dtype=np.float64)


def insulin_edges(max_insulin_mU_min: float) -> Floats:
    """Edges of the bins of insulin, mU/min, up to the pump's limit or a little beyond."""
    bins = int(np.ceil(max_insulin_mU_min / INSULIN_BIN_MU_MIN)) + 1
    return INSULIN_BIN_MU_MIN * np.arange(bins + 1, dtype=np.float64)


def bin_numbers(values: npt.NDArray[np.floating], edges: Floats) -> npt.NDArray[np.intp]:
    """Number of the bin of each value, all of them finite; a value on an edge counts above it."""
    place = values * values.dtype.type(1.0 / edges[1])
    # limited before it is made whole: what is far beyond the last bin does not fit an integer
    np.clip(place, 0, edges.size - 2, out=place)
    return place.astype(np.intp)


def quantiles_of_counts(
    edges: Floats, counts: npt.NDArray[np.int64], probabilities: Sequence[float] = BAND_QUANTILES
) -> npt.NDArray[np.float64]:
    """Quantiles ``(probabilities, rows)`` from counts ``(rows, bins)``, linear within a bin; NaN for a row without any.

    They are in the bin of the true ones, so that the error is less than the width of the bin.
    """
    ends = np.cumsum(counts, axis=1, dtype=np.float64)
    total = ends[:, -1]
    rows = np.arange(counts.shape[0])
    result = np.full((len(probabilities), counts.shape[0]), np.nan)
    for row, probability in enumerate(probabilities):
        place = probability * total
        # The first bin whose end reaches the place, and which holds somebody.
        number = np.argmax((ends >= place[:, None]) & (counts > 0), axis=1)
        inside = counts[rows, number]
        share = (place - (ends[rows, number] - inside)) / np.maximum(inside, 1)
        result[row] = edges[number] + (edges[number + 1] - edges[number]) * share
    result[:, total == 0] = np.nan
    return result


def times_pct(counts: npt.NDArray[np.int64]) -> dict[str, npt.NDArray[np.float64]]:
    """Shares of counts of glucose ``(rows, bins)`` in each range, by the name of the metric; NaN for a row without any.

    They are of samples, while a metric looks at glucose between the samples too.
    """
    with np.errstate(invalid="ignore"):
        share = 100.0 * counts / counts.sum(axis=1, keepdims=True)
    per_mg_dl = round(1.0 / GLUCOSE_BIN_MG_DL)
    return {
        name: share[:, low * per_mg_dl : high * per_mg_dl].sum(axis=1) for name, (low, high) in _TIMES_MG_DL.items()
    }


@dataclass
class Moments:
    """Count, mean, spread, minimum and maximum value of numbers."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0
    """Sum of squared distances from the mean."""
    least: float = np.inf
    greatest: float = -np.inf

    def add(self, values: Floats) -> None:
        """Include more numbers, all finite (Chan, Golub & LeVeque, Am. Stat. 37(3):242-247, 1983)."""
        if not values.size:
            return
        mean = float(values.mean())
        squares = float(np.square(values - mean).sum())
        together = self.count + values.size
        apart = mean - self.mean
        self.squares += squares + apart * apart * self.count * values.size / together
        self.mean += apart * values.size / together
        self.count = together
        self.least = min(self.least, float(values.min()))
        self.greatest = max(self.greatest, float(values.max()))

    @property
    def sd(self) -> float:
        """Standard deviation, with n - 1; NaN for fewer than two numbers."""
        return float(np.sqrt(self.squares / (self.count - 1))) if self.count > 1 else float("nan")


def finite(values: Floats) -> Floats:
    """The numbers that are finite."""
    remaining: Floats = values[np.isfinite(values)]
    return remaining


def quantiles(parts: Parts, counts: Sequence[int], probabilities: Sequence[float]) -> Floats:
    """Quantiles ``(columns, probabilities)`` of the finite numbers of each column, linear as by `numpy.quantile`.

    There are `counts` of them in each column; a column without any has NaN.
    """
    places = np.maximum(np.array(counts, float) - 1.0, 0.0)[:, None] * np.array(probabilities)
    sides = np.floor(places).astype(int), np.ceil(places).astype(int)
    ranks = [np.union1d(*pair).tolist() if count else [] for count, *pair in zip(counts, *sides, strict=True)]
    by_rank = (_gathered if max(counts, default=0) <= _FEW else _searched)(parts, ranks)
    result = np.full(places.shape, np.nan)
    for row, value in enumerate(by_rank):
        if value:
            low, high = (np.array([value[rank] for rank in side[row].tolist()]) for side in sides)
            result[row] = low + (high - low) * (places[row] - sides[0][row])
    return result


def _gathered(parts: Parts, ranks: Sequence[Sequence[int]]) -> list[dict[int, float]]:
    """Numbers of each column by their ranks, from all of its numbers."""
    read = [[finite(values) for values in part] for part in parts()]
    together = (np.sort(np.concatenate(column)) for column in zip(*read, strict=True))
    return [
        {rank: float(values[rank]) for rank in column_ranks}
        for values, column_ranks in zip(together, ranks, strict=True)
    ]


def _searched(parts: Parts, ranks: Sequence[Sequence[int]]) -> list[dict[int, float]]:
    """Numbers of each column by their ranks, digit by digit."""
    # by rank: its first digits, and the rank among the numbers that begin with them
    wanted = [{rank: (0, rank) for rank in column_ranks} for column_ranks in ranks]
    for shift in range(_BITS * (63 // _BITS), -1, -_BITS):
        counted = [{first: np.zeros(1 << _BITS, np.int64) for first, _ in by_rank.values()} for by_rank in wanted]
        for part in parts():
            for values, by_first in zip(part, counted, strict=True):
                if by_first:
                    digits = _ordered(finite(values)) >> np.uint64(shift)
                    first_digits, last = digits >> np.uint64(_BITS), (digits & _DIGIT).astype(np.intp)
                    for first, number in by_first.items():
                        number += np.bincount(last[first_digits == np.uint64(first)], minlength=number.size)
        for by_rank, by_first in zip(wanted, counted, strict=True):
            for rank, (first, among) in by_rank.items():
                number = by_first[first]
                ends = np.cumsum(number)
                digit = int(np.searchsorted(ends, among, "right"))
                by_rank[rank] = (first << _BITS) + digit, among - int(ends[digit] - number[digit])
    return [dict(zip(by_rank, _numbers([digits for digits, _ in by_rank.values()]), strict=True)) for by_rank in wanted]


def _ordered(values: Floats) -> npt.NDArray[np.uint64]:
    """Whole numbers in the order of finite numbers; a zero has no sign."""
    bits = (values + 0.0).view(np.uint64)
    return np.where(bits & _SIGN, ~bits, bits | _SIGN)


def _numbers(ordered: Sequence[int]) -> list[float]:
    """The numbers of which `_ordered` made these whole numbers."""
    whole = np.array(ordered, np.uint64)
    result: list[float] = np.where(whole & _SIGN, whole ^ _SIGN, ~whole).view(np.float64).tolist()
    return result


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
