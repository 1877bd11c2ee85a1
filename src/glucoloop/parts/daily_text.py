"""Text of a number that depends on the time of day: ``0.6@06:30 0.02@22:00``, or 24 numbers, one for each hour."""

from __future__ import annotations

import math
from typing import Final

from glucoloop.parts.clock_text import parse_time_of_day
from glucoloop.parts.number_text import number_of
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_H

DailyValues = tuple[tuple[float, float], ...]
"""Times of day in minutes after midnight, in their order, and the value from each of them on until the next."""

_HOURS: Final = 24
_EXAMPLE: Final = "write values and times, like '0.6@06:30 0.02@22:00', or 24 numbers, one for each hour"


def parse_daily(text: str) -> DailyValues:
    """Values by time of day from a text; the last of them holds until the first time of the next day.

    Raises
    ------
    ValueError
        For a text without values, a part that is no number with a time, a time that is given twice, or numbers without
        times that are not 24.
    """
    parts = text.split()
    if not parts:
        raise Refusal(f"there is no value for any time of day; {_EXAMPLE}")
    timed = ["@" in part for part in parts]
    if not any(timed):
        numbers = [_number(part) for part in parts]
        if len(numbers) != _HOURS:
            count = "1 number is" if len(numbers) == 1 else f"{len(numbers)} numbers are"
            raise Refusal(f"{count} not one for each hour of the day; {_EXAMPLE}")
        return tuple((hour * MIN_PER_H, number) for hour, number in enumerate(numbers))
    if not all(timed):
        raise Refusal(f"{parts[timed.index(False)]!r} has no time of day, unlike others; {_EXAMPLE}")
    values: dict[float, float] = {}
    for part in parts:
        value, _, time = part.partition("@")
        start_min = parse_time_of_day(time)
        if start_min in values:
            raise Refusal(f"the time {time} has two values; leave one out")
        values[start_min] = _number(value)
    return tuple(sorted(values.items()))


def _number(text: str) -> float:
    try:
        value = number_of(text, float)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refusal(f"{text!r} is no finite number; {_EXAMPLE}")
    return value
