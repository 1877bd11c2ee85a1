"""Readings of a monitor in the order of time, and the same on a grid, with gaps where too long nothing was read."""

from __future__ import annotations

import dataclasses
import datetime as dt
import functools
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY

Floats = npt.NDArray[np.float64]

LONGEST_FILLED_MIN: Final = 45.0
"""Longest time between two readings over which glucose is interpolated, as the consensus tools do."""
_MAX_DAYS: Final = 36_525
_DIVISORS: Final = tuple(step for step in range(1, 361) if MIN_PER_DAY % step == 0)
_MIN_READINGS: Final = 2
_AROUND: Final = 6
"""Number of steps to each side that tell the step of a sensor."""
_EARLY, _LATE, _MOST = 0.75, 1.25, 0.98


def stretches(there: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First place of each stretch in which something is there, and the place after its last one."""
    first, after = np.flatnonzero(np.diff(there.astype(int), prepend=0, append=0)).reshape(-1, 2).T.tolist()
    return list(zip(first, after, strict=True))


@dataclass(frozen=True)
class Segment:
    """Glucose without a gap: values at ``first``, ``first + 1``, ... steps of the grid after midnight of day 0."""

    first: int
    glucose_mg_dl: Floats


@dataclass(frozen=True)
class _GlucoseGrid:
    """Glucose at equal steps from midnight of the first day, NaN in gaps."""

    step_min: float
    first: int
    """Place of the first value: steps after midnight of day 0."""
    glucose_mg_dl: Floats

    def lagged(self, minutes: float) -> Floats:
        """Differences of glucose from that so many minutes earlier, where both are known; none between steps."""
        lag, between = divmod(round(minutes), round(self.step_min))
        if between or lag >= self.glucose_mg_dl.size:
            return np.empty(0)
        difference = self.glucose_mg_dl[lag:] - self.glucose_mg_dl[:-lag]
        return difference[np.isfinite(difference)]

    def segments(self) -> list[Segment]:
        """The stretches without a gap."""
        known = np.isfinite(self.glucose_mg_dl)
        return [Segment(self.first + low, self.glucose_mg_dl[low:high]) for low, high in stretches(known)]


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings by time; make them with `of`, or of a table with `of_times`."""

    t_min: Floats
    """(n,) minutes since midnight of day 0, rising."""
    glucose_mg_dl: Floats
    """(n,) finite readings."""
    interval_min: float
    """Time from reading to reading: the median, as whole minutes that divide a day."""
    day_0: dt.date | None = None
    """Date of day 0; None for a simulated course."""
    weight_min: Floats | None = None
    """(n,) time that each reading stands for; None where all stand for the same."""
    clock_shift_min: Floats | None = None
    """(n,) minutes by which the clock on the wall is ahead of that of the first reading; None where it is never set."""

    @classmethod
    def of(
        cls,
        t_min: npt.ArrayLike,
        glucose_mg_dl: npt.ArrayLike,
        day_0: dt.date | None = None,
        clock_shift_min: npt.ArrayLike | None = None,
    ) -> Self:
        """Readings from times and glucose; those that are not finite are left out, and equal times are averaged.

        Parameters
        ----------
        t_min : array_like
            (n,) minutes since a midnight, in any order.
        glucose_mg_dl : array_like
            (n,) glucose, of a monitor or a simulated person.
        day_0 : date, optional
            The day of that midnight.
        clock_shift_min : array_like, optional
            (n,) minutes by which the clock on the wall is ahead of these times, as after it was set to summer time.

        Raises
        ------
        Refusal
            For fewer than two readings, for readings of 0 mg/dl or less, and for times more than a century apart.
        """
        t, glucose = np.asarray(t_min, float), np.asarray(glucose_mg_dl, float)
        if t.shape != glucose.shape or t.ndim != 1:
            raise Refusal(f"times of shape {t.shape} and glucose of shape {glucose.shape} do not match")
        there = np.isfinite(t) & np.isfinite(glucose)
        shift = None if clock_shift_min is None else np.asarray(clock_shift_min, float)[there]
        t, first, places = np.unique(t[there], return_index=True, return_inverse=True)
        if t.size < _MIN_READINGS:
            raise Refusal(
                f"the record has {t.size} reading{'s' * (t.size != 1)} of glucose at different times, and no metric "
                "can be computed; the consensus asks for 14 days with 70 % of the readings"
            )
        glucose = glucose[there]
        glucose = glucose[first] if places.size == t.size else np.bincount(places, glucose) / np.bincount(places)
        if glucose.min() <= 0.0:
            raise Refusal(f"a reading of {glucose.min():g} mg/dl is not possible; leave it empty if it is missing")
        if t[-1] - t[0] > _MAX_DAYS * MIN_PER_DAY:
            raise Refusal("the first and the last reading are more than a century apart; mend the wrong times")
        median = max(1, round(float(np.median(np.diff(t)))))
        interval = next(step for step in reversed(_DIVISORS) if step <= median)
        shift = None if shift is None or not shift.any() else shift[first]
        return cls(t, glucose, float(interval), day_0, _weights_min(t), shift)

    @classmethod
    def of_times(
        cls, times: npt.ArrayLike, glucose_mg_dl: npt.ArrayLike, utc_offset_min: npt.ArrayLike | None = None
    ) -> Self:
        """Readings from dates with times on the wall, as of the column of a table, and their offsets from UTC.

        Without an offset for each reading the clock on the wall is taken as one that is never set.
        """
        moments = np.asarray(times).astype("datetime64[us]")
        glucose = np.asarray(glucose_mg_dl, float)
        moments = moments[np.isfinite(glucose) & ~np.isnat(moments)]
        if not moments.size:
            return cls.of([], [])
        midnight = moments.min().astype("datetime64[D]")
        t_min = (np.asarray(times).astype("datetime64[us]") - midnight) / np.timedelta64(1, "m")
        day: Any = midnight.astype(object)
        if utc_offset_min is None:
            return cls.of(t_min, glucose, day)
        offsets = np.asarray(utc_offset_min, float)
        if not np.isfinite(offsets).all() or np.all(offsets == offsets[0]):
            return cls.of(t_min, glucose, day)
        shift = offsets - offsets[np.argmin(t_min - offsets)]
        return cls.of(t_min - shift, glucose, day, shift)

    @functools.cached_property
    def day(self) -> npt.NDArray[np.int64]:
        """(n,) number of the day of each reading."""
        days = np.floor_divide(self.clock_min, MIN_PER_DAY).astype(np.int64)
        return days if self.clock_shift_min is None else np.maximum.accumulate(days)

    @property
    def clock_min(self) -> Floats:
        """(n,) time on the wall of each reading, in minutes since midnight of day 0."""
        return self.t_min if self.clock_shift_min is None else self.t_min + self.clock_shift_min

    @property
    def time_of_day_min(self) -> Floats:
        """(n,) minutes since midnight on the clock on the wall."""
        if self.clock_shift_min is None:
            return self.t_min - MIN_PER_DAY * self.day
        return np.mod(self.clock_min, MIN_PER_DAY)

    def clock_at(self, t_min: float) -> float:
        """Time on the wall at a moment, in minutes since midnight of day 0."""
        if self.clock_shift_min is None:
            return t_min
        place = max(0, int(np.searchsorted(self.t_min, t_min, side="right")) - 1)
        return t_min + float(self.clock_shift_min[place])

    def date(self, day: int) -> str:
        """Name of a day: its date, or its number from 1 for a simulated course."""
        return f"day {day + 1}" if self.day_0 is None else f"{self.day_0 + dt.timedelta(days=day)}"

    def moment(self, t_min: float) -> str:
        """Date and time of day of a moment."""
        day, minutes = divmod(round(self.clock_at(t_min)), int(MIN_PER_DAY))
        return f"{self.date(day)} {minutes // 60:02d}:{minutes % 60:02d}"

    def only(self, chosen: npt.NDArray[np.bool_]) -> Readings | None:
        """Some of the readings, with the same interval; None for fewer than two."""
        return self._part(chosen) if np.count_nonzero(chosen) >= _MIN_READINGS else None

    def between(self, low: int, high: int) -> Readings:
        """Readings from one place up to another, with the same interval."""
        return self._part(slice(low, high))

    def _part(self, chosen: npt.NDArray[np.bool_] | slice) -> Readings:
        weights, shifts = (
            None if values is None else values[chosen] for values in (self.weight_min, self.clock_shift_min)
        )
        if weights is not None and np.all(weights == self.interval_min):
            weights = None
        return dataclasses.replace(
            self,
            t_min=self.t_min[chosen],
            glucose_mg_dl=self.glucose_mg_dl[chosen],
            weight_min=weights,
            clock_shift_min=shifts,
        )

    @functools.cached_property
    def expected(self) -> int:
        """Number of readings from the first to the last one if none were missing."""
        steps = np.rint(np.diff(self.t_min) / self.interval_min)
        return 1 + int(np.maximum(steps, 1.0).sum())

    @property
    def by_count(self) -> Readings:
        """The same readings, of which each counts alike."""
        return dataclasses.replace(self, weight_min=None)

    def mean(self, values: npt.ArrayLike) -> float:
        """Mean of values of the readings, each for the time that it stands for."""
        of = np.asarray(values)
        return float(of.mean()) if self.weight_min is None else float(np.average(of, weights=self.weight_min))

    @functools.cached_property
    def grid(self) -> _GlucoseGrid:
        """Glucose at each interval; see `at_steps`."""
        return self.at_steps(self.interval_min)

    def at_steps(self, step_min: float) -> _GlucoseGrid:
        """Glucose at equal steps, interpolated between readings at most 45 min apart."""
        first, last = int(np.ceil(self.t_min[0] / step_min)), int(np.floor(self.t_min[-1] / step_min))
        t = step_min * np.arange(first, last + 1, dtype=float)
        glucose = np.interp(t, self.t_min, self.glucose_mg_dl)
        after = np.searchsorted(self.t_min, t, side="left").clip(1, self.t_min.size - 1)
        gap = self.t_min[after] - self.t_min[after - 1]
        inside = (t > self.t_min[after - 1]) & (t < self.t_min[after])
        return _GlucoseGrid(step_min, first, np.where(inside & (gap > LONGEST_FILLED_MIN), np.nan, glucose))


def _weights_min(t_min: Floats) -> Floats | None:
    """Time that each reading stands for: until the next one, and at most one step of the sensor; None where all alike.

    The step of a sensor is the second least of some before or after, at most `LONGEST_FILLED_MIN`, so that missing
    readings make it no longer. A reading stands for it as a whole where the next one is late by any time, or early by
    up to a quarter, as readings of a sensor are.
    """
    steps = np.diff(t_min)
    usual = max(1.0, round(float(np.median(steps))))
    if np.all(steps >= _EARLY * usual):
        inside = steps[steps <= _LATE * usual]
        # a change to longer steps is one of the sensor; a few that are late are readings that are missing
        if inside.size >= _MOST * steps.size or usual >= LONGEST_FILLED_MIN:
            return None
    before, after = _least_steps(steps[::-1])[::-1], _least_steps(steps)
    nearer = np.abs(np.log(steps / before)) <= np.abs(np.log(steps / after))
    local = _alike(np.where(nearer, before, after), usual)
    weights = np.where(steps >= _EARLY * local, local, steps)
    result = np.append(weights, weights[-1])
    return None if np.count_nonzero(result != np.median(result)) <= _AROUND else result


def _least_steps(steps: Floats) -> Floats:
    """Second least of each step and those after it, in whole minutes."""
    near = np.lib.stride_tricks.sliding_window_view(np.pad(steps, (0, _AROUND), mode="reflect"), _AROUND + 1)
    return np.minimum(np.maximum(1.0, np.rint(np.partition(near, 1, axis=-1)[:, 1])), LONGEST_FILLED_MIN)


def _alike(steps: Floats, usual: float) -> Floats:
    """Steps of which those that are alike are one: the usual one, and the median of the others."""
    result = np.where(np.abs(steps / usual - 1.0) <= 1.0 - _EARLY, usual, steps)
    others = result[result != usual]
    if others.size:
        second = round(float(np.median(others)))
        result = np.where((result != usual) & (np.abs(result / second - 1.0) <= 1.0 - _EARLY), second, result)
    return np.minimum(result, LONGEST_FILLED_MIN)
