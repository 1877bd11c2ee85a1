"""Numbers and times of day, as a person writes them."""

from __future__ import annotations

import math
import re
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

UNITS_OF_TIME: Final = {"min": 1.0, "m": 1.0, "h": MIN_PER_H, "d": MIN_PER_DAY}
"""Minutes in each unit in which a time may be written."""
# No two parts in a row can take the same characters: a long text that is no number is refused as fast as it is read.
NUMBER: Final = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
"""Pattern of a number, to be used with ``re.ASCII``."""


def number_of(text: str) -> float:
    """A number from its text; ValueError for none, also one with underscores or digits of another script."""
    if not text.isascii() or "_" in text:
        raise Refusal(f"{text!r} is no number; write it in digits from 0 to 9, without underscores")
    return float(text)


def parse_time_of_day(text: str) -> float:
    """Minutes after midnight from a text like 07:30."""
    result = re.fullmatch(r"([0-9]{1,2}):([0-5][0-9])", text.strip())
    minutes = math.nan if result is None else int(result[1]) * MIN_PER_H + int(result[2])
    if not minutes < MIN_PER_DAY:
        raise Refusal(f"{text!r} is no time of day; write it like 07:30, from 00:00 to 23:59")
    return minutes
