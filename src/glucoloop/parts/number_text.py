"""Numbers, times of day, and numbers that depend on the time of day, as a person writes them."""

from __future__ import annotations

import math
import re
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.units import HOURS_PER_DAY, MIN_PER_DAY, MIN_PER_H

DailyValues = tuple[tuple[float, float], ...]
"""Times of day in minutes after midnight, in their order, and the value from each of them on until the next."""

UNITS_OF_TIME: Final = {"min": 1.0, "m": 1.0, "h": MIN_PER_H, "d": MIN_PER_DAY}
"""Minutes in each unit in which a time may be written."""
# No two parts in a row can take the same characters: a long text that is no number is refused as fast as it is read.
NUMBER: Final = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
"""Pattern of a number, to be used with ``re.ASCII``."""
_DAILY: Final = "write values and times, like '0.6@06:30 0.02@22:00', or 24 numbers, one for each hour"


def number_of(text: str) -> float:
    """A number from its text; ValueError for none, also one with underscores or digits of another script."""
    if not text.isascii() or "_" in text:
        raise Refusal(f"{text!r} is no number; write it in digits from 0 to 9, without underscores")
    return float(text)


def parse_time_of_day(text: str) -> float:
    """Minutes after midnight from a text like 07:30."""
    found = re.fullmatch(r"([0-9]{1,2}):([0-5][0-9])", text.strip())
    minutes = math.nan if found is None else int(found[1]) * MIN_PER_H + int(found[2])
    if not minutes < MIN_PER_DAY:
        raise Refusal(f"{text!r} is no time of day; write it like 07:30, from 00:00 to 23:59")
    return minutes


def time_of_day_text(start_min: float) -> str:
    """Minutes after midnight as text; parts of a minute are left out."""
    hours, minutes = divmod(int(start_min), int(MIN_PER_H))
    return f"{hours:02d}:{minutes:02d}"


def parse_daily(text: str) -> DailyValues:
    """Values by time of day from a text; the last of them holds until the first time of the next day.

    The text holds values with times, ``0.6@06:30 0.02@22:00``, or 24 numbers, one for each hour.
    """
    items = text.split()
    if not items:
        raise Refusal(f"there is no value for any time of day; {_DAILY}")
    timed = ["@" in item for item in items]
    if not any(timed):
        numbers = list(map(_finite, items))
        if len(numbers) != HOURS_PER_DAY:
            count = "1 number is" if len(numbers) == 1 else f"{len(numbers)} numbers are"
            raise Refusal(f"{count} not one for each hour of the day; {_DAILY}")
        return tuple((hour * MIN_PER_H, number) for hour, number in enumerate(numbers))
    if not all(timed):
        raise Refusal(f"{items[timed.index(False)]!r} has no time of day, unlike others; {_DAILY}")
    values: dict[float, float] = {}
    for item in items:
        value, _, time = item.partition("@")
        start_min = parse_time_of_day(time)
        if start_min in values:
            raise Refusal(f"the time {time} has two values; leave one out")
        values[start_min] = _finite(value)
    return tuple(sorted(values.items()))


def _finite(text: str) -> float:
    try:
        value = number_of(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refusal(f"{text!r} is no finite number; {_DAILY}")
    return value
