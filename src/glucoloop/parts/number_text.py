"""Numbers that a person writes, and the units of times."""

from __future__ import annotations

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
