"""Insulin, carbohydrate and glucagon that a record tells beside its readings, and their sums by the day.

A day counts where the readings begin within its first hour or before it and end within its last one or after it. What
is not told is not zero: boluses are known from the day of the first one to that of the last, carbohydrate and injected
long-acting insulin likewise, and basal insulin on days with a rate for all but an hour. The last rate holds to the end
of the day of the last dose or rate, for readings may go on where a record has no more of the pump.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from glucoloop.metrics.metric import Result
from glucoloop.metrics.readings.distribution import sufficiency
from glucoloop.metrics.readings.series import Floats, Readings
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

_MAX_UNKNOWN_MIN: Final = 60.0
_CENTURY_MIN: Final = 36_525.0 * MIN_PER_DAY


class Amounts(NamedTuple):
    """Amounts in the order of time."""

    clock_min: Floats
    """``(n,)`` time on the wall, in minutes since midnight of day 0 of the readings."""
    amount: Floats
    """``(n,)`` amounts, in the unit of their name in `Given`."""

    @classmethod
    def of_all(cls, parts: Iterable[Amounts]) -> Amounts:
        """Amounts of several people after each other."""
        times, amounts = zip(*parts, strict=True)
        return cls(np.concatenate(times), np.concatenate(amounts))

    def within(self, readings: Readings) -> Amounts:
        """Amounts from the first reading to the last."""
        first, last = readings.clock_min[[0, -1]]
        inside = (self.clock_min >= first) & (self.clock_min <= last)
        return Amounts(self.clock_min[inside], self.amount[inside])

    def of_day(self, day: int) -> Amounts:
        """Amounts of a day on the wall, counted from day 0."""
        inside = np.floor(self.clock_min / MIN_PER_DAY) == day
        return Amounts(self.clock_min[inside], self.amount[inside])

    def known_on(self, day: int) -> bool:
        """Whether a day is not before that of the first amount, and not after that of the last one."""
        if not self.amount.size:
            return False
        return bool(self.clock_min[0] // MIN_PER_DAY <= day <= self.clock_min[-1] // MIN_PER_DAY)


NOTHING: Final = Amounts(np.empty(0), np.empty(0))


@dataclass(frozen=True, kw_only=True)
class Given:
    """Doses and meals that a record tells beside readings."""

    basal_U_h: Amounts = NOTHING
    """Rates, each from its time to the next one; NaN where none is known."""
    insulin_U_h: Amounts = NOTHING
    """Rates of all insulin, likewise, where nothing tells what of it is basal and what boluses."""
    bolus_U: Amounts = NOTHING
    long_acting_U: Amounts = NOTHING
    carbs_g: Amounts = NOTHING
    glucagon_ug: Amounts = NOTHING
    complete: bool = False
    """Whether what is not told did not happen, as in a simulation."""


NOTHING_GIVEN: Final = Given()

GIVEN_RESULTS: Final = (
    Result(
        "insulin_U_day",
        "Mean insulin of a whole day, basal and by boluses, of the days of which the record tells both.",
        "Insulin a day",
        "U",
    ),
    Result("basal_pct", "Part of it that is basal or long-acting.", "Basal or long-acting part", "%"),
    Result(
        "bolus_U_day",
        "Mean insulin by boluses of a whole day, from that of the first bolus to that of the last.",
        "Insulin by boluses a day",
        "U",
    ),
    Result("boluses_day", "Mean number of boluses of these days.", "Boluses a day"),
    Result(
        "carbs_g_day",
        "Mean carbohydrate of a whole day, from that of the first entry to that of the last; what was not entered is "
        "not in it.",
        "Carbohydrate a day",
        "g",
        digits=0,
    ),
    Result(
        "carb_entries_day", "Mean number of entries of carbohydrate of these days.", "Entries of carbohydrate a day"
    ),
    Result("glucagon_ug_day", "Glucagon in a day of 24 h, as entered.", "Glucagon", "ug a day"),
)
"""Results of a record that tells doses or meals."""
SECTION: Final = "Insulin and carbohydrate"
GLUCAGON: Final = GIVEN_RESULTS[-1].name


def whole_days(readings: Readings) -> list[int]:
    """Days, counted from day 0, from whose first hour to whose last there are readings."""
    first, last = ((readings.clock_min[end] + side) / MIN_PER_DAY for end, side in ((0, -MIN_PER_H), (-1, MIN_PER_H)))
    return list(range(math.ceil(first), math.floor(last)))


def day_sums(given: Given, days: Iterable[int]) -> dict[int, dict[str, float]]:
    """Sums of each of some days; NaN for what the record does not tell of it."""
    basal, insulin = (_integral(given, rates) for rates in (given.basal_U_h, given.insulin_U_h))
    return {day: _sums_of(given, basal, insulin, day) for day in days}


def given_numbers(given: Given, readings: Readings) -> dict[str, float]:
    """Numbers `GIVEN_RESULTS` of a record by name; NaN for what it does not tell."""
    days = list(day_sums(given, whole_days(readings)).values())
    insulin = [one for one in days if math.isfinite(one["insulin_U"])]
    total_U = sum(one["insulin_U"] for one in insulin)
    glucagon = given.glucagon_ug.within(readings).amount.sum()
    return {
        "insulin_U_day": total_U / len(insulin) if insulin else math.nan,
        "basal_pct": 100.0 * sum(one["basal_U"] for one in insulin) / total_U if total_U > 0.0 else math.nan,
        "bolus_U_day": _mean(days, "bolus_U"),
        "boluses_day": _mean(days, "boluses"),
        "carbs_g_day": _mean(days, "carbs_g"),
        "carb_entries_day": _mean(days, "carb_entries"),
        GLUCAGON: float(glucagon) / sufficiency(readings)["days"],
    }


def known_results(numbers: Sequence[Mapping[str, float]]) -> list[Result]:
    """Results of `GIVEN_RESULTS` that one of some records tells; glucagon where there is any."""

    def known(name: str) -> bool:
        values = [of[name] for of in numbers]
        return any(value > 0.0 for value in values) if name == GLUCAGON else any(map(math.isfinite, values))

    return [result for result in GIVEN_RESULTS if known(result.name)]


def _mean(days: Sequence[Mapping[str, float]], name: str) -> float:
    values = [one[name] for one in days if math.isfinite(one[name])]
    return sum(values) / len(values) if values else math.nan


class _Integral(NamedTuple):
    """Insulin by the known rates, and time with a known one, up to each change of the rate and to the end."""

    t_min: Floats
    amount_U: Floats
    known_min: Floats

    def at(self, t_min: float) -> tuple[float, float]:
        """Insulin and time up to a time, by interpolation."""
        return float(np.interp(t_min, self.t_min, self.amount_U)), float(np.interp(t_min, self.t_min, self.known_min))


def _integral(given: Given, rates: Amounts) -> _Integral | None:
    if not np.isfinite(rates.amount).any():
        return None
    # of several rates at one time the last one holds, which is the first of the reversed ones
    t, last = np.unique(rates.clock_min[::-1], return_index=True)
    rate = rates.amount[::-1][last]
    ends = [one.clock_min[-1] for one in (rates, given.bolus_U, given.long_acting_U) if one.amount.size]
    end = t[-1] + _CENTURY_MIN if given.complete else MIN_PER_DAY * (1.0 + np.floor(max(ends) / MIN_PER_DAY))
    edges = np.append(t, end)
    known = np.isfinite(rate)
    amount = np.cumsum(np.diff(edges) * np.where(known, rate, 0.0) / MIN_PER_H)
    return _Integral(edges, np.insert(amount, 0, 0.0), np.insert(np.cumsum(np.diff(edges) * known), 0, 0.0))


def _by_rate(integral: _Integral | None, day: int) -> float:
    """Insulin of a day by rates; NaN where they are not known for all but an hour of it."""
    if integral is None:
        return math.nan
    (before_U, before_min), (after_U, after_min) = (integral.at(MIN_PER_DAY * one) for one in (day, day + 1))
    return after_U - before_U if MIN_PER_DAY - (after_min - before_min) <= _MAX_UNKNOWN_MIN else math.nan


def _sums_of(given: Given, by_basal_rate: _Integral | None, by_all: _Integral | None, day: int) -> dict[str, float]:
    by_rate = _by_rate(by_basal_rate, day)
    injected, bolus, carbs = (
        amounts.of_day(day).amount if given.complete or amounts.known_on(day) else None
        for amounts in (given.long_acting_U, given.bolus_U, given.carbs_g)
    )
    parts = [amount for amount in (by_rate, _sum(injected)) if math.isfinite(amount)]
    basal = sum(parts) if parts else math.nan
    return {
        "insulin_U": basal + _sum(bolus) if by_all is None else _by_rate(by_all, day),
        "basal_U": basal,
        "bolus_U": _sum(bolus),
        "boluses": math.nan if bolus is None else float(bolus.size),
        "carbs_g": _sum(carbs),
        "carb_entries": math.nan if carbs is None else float(carbs.size),
    }


def _sum(amounts: Floats | None) -> float:
    return math.nan if amounts is None else float(amounts.sum())
