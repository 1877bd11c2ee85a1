"""Exact quantiles of many numbers that come in parts, in memory that does not grow with their number.

Some of the numbers are taken as marks. A first reading counts the numbers at each mark and between neighbouring marks,
which gives the place of every wanted rank: at a mark, so that it is known, or in a gap. A second reading gathers the
numbers of these gaps; a gap with too many numbers gets marks of its own, and is searched in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

MARKS: Final = 2048
FEW: Final = 8192
"""Largest number of values that are gathered in a gap."""
_SAMPLED: Final = 64
"""Number of values of a part that are taken as marks in a gap with too many."""

Floats = npt.NDArray[np.float64]
Parts = Callable[[], Iterable[Sequence[Floats]]]
"""Function that reads the parts again from the first one; each holds the numbers of every column."""


@dataclass
class Moments:
    """Count, mean, spread, least and greatest value of numbers."""

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
    kept: Floats = values[np.isfinite(values)]
    return kept


def quantiles(parts: Parts, counts: Sequence[int], probabilities: Sequence[float]) -> Floats:
    """Quantiles ``(columns, probabilities)`` of the finite numbers of each column, linear as by `numpy.quantile`.

    There are `counts` of them in each column; a column without any has NaN.
    """
    searches = [_Search(count, probabilities) for count in counts]
    for part in parts():
        for search, values in zip(searches, part, strict=True):
            search.begin(np.sort(finite(values)))
        if all(search.begun for search in searches):
            break
    while any(search.intervals for search in searches):
        for reads in (_Search.count, _Search.gather):
            for part in parts():
                for search, values in zip(searches, part, strict=True):
                    if search.intervals:
                        reads(search, np.sort(finite(values)))
            for search in searches:
                search.next()
    return np.array([search.quantiles() for search in searches])


def _marks(values: Floats, most: int) -> Floats:
    """A selection of sorted numbers, without repetition."""
    return np.unique(values[np.linspace(0, values.size - 1, min(most, values.size)).astype(np.intp)])


def _between(values: Floats, low: float, high: float) -> Floats:
    """Sorted numbers strictly between two limits."""
    return values[np.searchsorted(values, low, "right") : np.searchsorted(values, high, "left")]


@dataclass
class _Gap:
    """The numbers between two marks, among which ranks are wanted."""

    low: float
    high: float
    below: int
    """Count of the numbers up to the lower mark."""
    count: int
    ranks: list[int]
    taken: list[Floats] = field(default_factory=list)

    def take(self, values: Floats) -> None:
        inside = _between(values, self.low, self.high)
        if self.count <= FEW:
            self.taken.append(inside.copy())
        elif inside.size and sum(taken.size for taken in self.taken) < MARKS:
            self.taken.append(_marks(inside, _SAMPLED))


class _Interval:
    """The numbers between two limits, counted at marks and between them."""

    def __init__(self, low: float, high: float, below: int, ranks: list[int], marks: Floats) -> None:
        self.low, self.high, self.below, self.ranks, self.marks = low, high, below, ranks, marks
        self.counts = np.zeros(2 * marks.size + 1, np.int64)
        """Counts below the first mark, at it, between it and the second, and so on."""

    def count(self, values: Floats) -> None:
        inside = _between(values, self.low, self.high)
        ends = np.empty(self.counts.size + 1, np.int64)
        ends[0], ends[-1] = 0, inside.size
        ends[1:-1:2], ends[2:-1:2] = (np.searchsorted(inside, self.marks, side) for side in ("left", "right"))
        self.counts += np.diff(ends)

    def divide(self, found: dict[int, float]) -> Iterator[_Gap]:
        """Record the ranks that are at a mark, and yield the gaps that hold the others."""
        ends = self.below + np.cumsum(self.counts)
        places = np.searchsorted(ends, self.ranks, "right")
        for place in np.unique(places).tolist():
            ranks = [rank for rank, of_rank in zip(self.ranks, places, strict=True) if of_rank == place]
            after, at_mark = divmod(place, 2)
            if at_mark:
                found.update(dict.fromkeys(ranks, float(self.marks[after])))
                continue
            low = self.low if after == 0 else float(self.marks[after - 1])
            high = self.high if after == self.marks.size else float(self.marks[after])
            count = int(self.counts[place])
            yield _Gap(low, high, int(ends[place]) - count, count, ranks)


class _Search:
    """The wanted ranks of one column."""

    def __init__(self, count: int, probabilities: Sequence[float]) -> None:
        self.places = [max(0, count - 1) * probability for probability in probabilities]
        self.ranks = sorted({rank for place in self.places for rank in (int(place), int(np.ceil(place)))})
        self.begun = not count
        self.found: dict[int, float] = {}
        self.intervals: list[_Interval] = []
        self.gaps: list[_Gap] | None = None
        """Gaps that are gathered, or None while numbers are counted."""

    def begin(self, values: Floats) -> None:
        if not self.begun and values.size:
            self.begun = True
            self.intervals = [_Interval(-np.inf, np.inf, 0, self.ranks, _marks(values, MARKS))]

    def count(self, values: Floats) -> None:
        for interval in self.intervals:
            interval.count(values)

    def gather(self, values: Floats) -> None:
        for gap in self.gaps or ():
            gap.take(values)

    def next(self) -> None:
        """Proceed from counting to gathering, or from gathering to intervals for gaps with too many numbers."""
        if self.gaps is None:
            self.gaps = [gap for interval in self.intervals for gap in interval.divide(self.found)]
            return
        self.intervals = []
        for gap in self.gaps:
            values = np.sort(np.concatenate(gap.taken))
            if gap.count <= FEW:
                self.found.update({rank: float(values[rank - gap.below]) for rank in gap.ranks})
            else:
                self.intervals.append(_Interval(gap.low, gap.high, gap.below, gap.ranks, _marks(values, MARKS)))
        self.gaps = None

    def quantiles(self) -> list[float]:
        if not self.found:
            return [float("nan")] * len(self.places)
        return [self._quantile(place) for place in self.places]

    def _quantile(self, place: float) -> float:
        low, high = self.found[int(place)], self.found[int(np.ceil(place))]
        return low + (high - low) * (place - int(place))
