"""Text of a time of day, like 07:30."""

from __future__ import annotations

import re

from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY, MIN_PER_H


def parse_time_of_day(text: str) -> float:
    """Minutes after midnight from a text like 07:30.

    Raises
    ------
    ValueError
        For a text that is not a time of day.
    """
    found = re.fullmatch(r"([0-9]{1,2}):([0-5][0-9])", text.strip())
    minutes = float("nan") if found is None else int(found[1]) * MIN_PER_H + int(found[2])
    if not minutes < MIN_PER_DAY:
        raise Refusal(f"{text!r} is no time of day; write it like 07:30, from 00:00 to 23:59")
    return minutes


def time_of_day_text(start_min: float) -> str:
    """Minutes after midnight as text; parts of a minute are left out."""
    hours, minutes = divmod(int(start_min), int(MIN_PER_H))
    return f"{hours:02d}:{minutes:02d}"
