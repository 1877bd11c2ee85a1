"""Numbers that a person writes, and times with their units: ``10h`` is 600 min."""

from __future__ import annotations

import re
from typing import Final, TypeVar

from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

Number = TypeVar("Number", int, float)

UNITS_OF_TIME: Final = {"min": 1.0, "m": 1.0, "h": MIN_PER_H, "d": MIN_PER_DAY}
"""Minutes in each unit in which a time may be written."""
# No two parts in a row can take the same characters: a long text that is no number is refused as fast as it is read.
NUMBER: Final = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
"""Pattern of a number, to be used with ``re.ASCII``."""
UNIT_OF_TIME: Final = "min|m|h|d"
_TIME: Final = re.compile(rf"\s*(?P<number>{NUMBER})\s*(?P<unit>{UNIT_OF_TIME})\s*", re.ASCII)
_OTHER_QUANTITY: Final = re.compile(r"(?:^|_)(?:[munp]?U|[mk]?g|dl|l|[mp]?mol)_min$")
"""End of a name whose minutes are those of a rate."""


def number_of(text: str, kind: type[Number]) -> Number:
    """A number from its text.

    Raises
    ------
    ValueError
        For a text that is no number, also one that only Python takes for one: with underscores or digits of another
        script.
    """
    if not in_digits(text):
        raise Refusal(f"{text!r} is no number; write it in digits from 0 to 9, without underscores")
    return kind(text)


def in_digits(text: str) -> bool:
    """Whether a text holds nothing that Python takes for a part of a number and people do not."""
    return text.isascii() and "_" not in text


def minutes_of(text: str) -> float | None:
    """Minutes of a time with its unit, like 10h; None for another text, also for a number without a unit."""
    match = _TIME.fullmatch(text)
    return None if match is None else float(match["number"]) * UNITS_OF_TIME[match["unit"]]


def is_time(key: str) -> bool:
    """Whether the value of a key is a time in minutes, by the unit at the end of its name."""
    return key.endswith("_min") and not _OTHER_QUANTITY.search(key)


def with_minutes(key: str, value: object) -> object:
    """The value of a key as minutes where it is a time with its unit; any other value as it is."""
    minutes = minutes_of(value) if isinstance(value, str) and is_time(key) else None
    return value if minutes is None else minutes
