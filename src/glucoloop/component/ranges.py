"""Ranges of numbers that a search tunes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from glucoloop.component.setting import number_with_unit
from glucoloop.refusal import Refusal
from glucoloop.units import UNIT_BY_ENDING, ending_of

_ENDS: Final = 2
_DIGITS: Final = 4
"""Significant digits of a tuned number; more make no difference to a loop."""


@dataclass(frozen=True)
class Tuned:
    """A number that is searched for, from `low` to `high`, both included; the bounds are refused if they are none."""

    name: str
    """Name of the setting."""
    low: float
    high: float
    log: bool
    """Whether its logarithm is searched."""
    by_default: bool = True
    """Whether it is searched for even where no range is given."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise Refusal(
                f"{self.name} is searched from {self.low:g} to {self.high:g}; give two finite numbers, the lower first"
            )
        if self.log and not self.low > 0.0:
            raise Refusal(
                f"{self.name} is searched from {self.low:g} on, but by its logarithm; give a lower bound above 0"
            )

    def at(self, share: float) -> float:
        """Number at a share of the way from the lower bound to the upper one, 0 to 1."""
        if self.log:
            return self.rounded(self.low * (self.high / self.low) ** share)
        return self.rounded(self.low + (self.high - self.low) * share)

    def rounded(self, value: float) -> float:
        """A number rounded to the significant digits, within the bounds."""
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high)

    def holds(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        return self.low <= value <= self.high

    @property
    def text(self) -> str:
        """Text of the range, as it is written."""
        return f"{self.low:.12g}:{self.high:.12g}"


def parse_range(text: str, default: Tuned) -> Tuned | float:
    """Range from a text: ``.1:2``, with both ends; or one number, which is fixed. Numbers may have their unit.

    The default range of the setting says whether its logarithm is searched.
    """
    unit = UNIT_BY_ENDING.get(ending_of(default.name), "")
    numbers = [
        float(result) for part in text.split(":") if (result := number_with_unit(part.strip(), unit)) is not None
    ]
    if len(numbers) != text.count(":") + 1 or len(numbers) > _ENDS or not all(map(math.isfinite, numbers)):
        raise Refusal(f"{default.name} is {text!r}; write it like .1:2, or one number that is kept")
    if len(numbers) == 1:
        return numbers[0]
    try:
        return Tuned(default.name, numbers[0], numbers[1], log=default.log)
    except Refusal as error:
        raise Refusal(f"{default.name} is {text!r}: {error}") from None
