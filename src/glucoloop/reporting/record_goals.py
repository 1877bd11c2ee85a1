"""Ranges of glucose, and goals for the time in each, of the consensus of 2019.

References
----------
T. Battelino et al., "Clinical targets for continuous glucose monitoring data interpretation: recommendations from the
international consensus on time in range", Diabetes Care 42(8), 1593-1603, 2019.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from glucoloop.reporting._style import RANGE_COLOURS

MIN_DAYS: Final = 14.0
MIN_ACTIVE_PCT: Final = 70.0
"""Minimum days, and minimum share of the readings, for which the consensus takes a record to stand for other days."""
HIGHEST_CV_PCT: Final = 36.0


class _Goal(NamedTuple):
    """Goal of the consensus for a number: less, or more, than a bound."""

    bound: float
    more: bool = False

    @property
    def text(self) -> str:
        """The goal in words."""
        return f"{'more' if self.more else 'less'} than {self.bound:g}\N{NO-BREAK SPACE}%"

    def reached(self, value: float) -> bool:
        """Whether a value is as aimed at."""
        return value > self.bound if self.more else value < self.bound


class _GlucoseRange(NamedTuple):
    """A range of the bar of times in ranges."""

    name: str
    bounds: str
    result: str
    colour: str


@dataclass(frozen=True)
class Goals:
    """Ranges and goals of one kind of people."""

    name: str
    target_mg_dl: tuple[float, float]
    ranges: tuple[_GlucoseRange, ...]
    """Ranges from the highest on; together they hold all readings."""
    goals: Mapping[str, _Goal]

    @property
    def lines(self) -> Iterator[_GlucoseRange]:
        """Ranges from the highest on, with the sums that have goals of their own, which have no name and no colour."""
        sums = [name for name in _SUMS if name in self.goals]
        for one in self.ranges:
            yield one
            side = {"Very low": "below", "High": "above_180"}.get(one.name)
            yield from (_GlucoseRange("", _SUMS[name], name, "") for name in sums if side and side in name)


_SUMS: Final = {
    "time_above_180_pct": "All above 180 mg/dl",
    "time_below_70_pct": "All below 70 mg/dl",
    "time_below_63_pct": "All below 63 mg/dl",
}
_COLOURS: Final = tuple(RANGE_COLOURS.values())
_RANGES: Final = (
    _GlucoseRange("Very high", "above 250 mg/dl", "time_above_250_pct", _COLOURS[4]),
    _GlucoseRange("High", "181 to 250 mg/dl", "time_180_250_pct", _COLOURS[3]),
    _GlucoseRange("Target", "70 to 180 mg/dl", "time_70_180_pct", _COLOURS[2]),
    _GlucoseRange("Low", "54 to 69 mg/dl", "time_54_70_pct", _COLOURS[1]),
    _GlucoseRange("Very low", "below 54 mg/dl", "time_below_54_pct", _COLOURS[0]),
)
_PREGNANCY: Final = (
    _GlucoseRange("High", "above 140 mg/dl", "time_above_140_pct", _COLOURS[3]),
    _GlucoseRange("Target", "63 to 140 mg/dl", "time_63_140_pct", _COLOURS[2]),
    _GlucoseRange("Low", "54 to 62 mg/dl", "time_54_63_pct", _COLOURS[1]),
    _GlucoseRange("Very low", "below 54 mg/dl", "time_below_54_pct", _COLOURS[0]),
)
GOALS: Final = {
    "adult": Goals(
        "adults with type 1 or type 2 diabetes",
        (70.0, 180.0),
        _RANGES,
        {
            "time_above_250_pct": _Goal(5.0),
            "time_above_180_pct": _Goal(25.0),
            "time_70_180_pct": _Goal(70.0, more=True),
            "time_below_70_pct": _Goal(4.0),
            "time_below_54_pct": _Goal(1.0),
        },
    ),
    "older": Goals(
        "older people or people at high risk",
        (70.0, 180.0),
        _RANGES,
        {
            "time_above_250_pct": _Goal(10.0),
            "time_70_180_pct": _Goal(50.0, more=True),
            "time_below_70_pct": _Goal(1.0),
        },
    ),
    "pregnancy": Goals(
        "pregnancy with type 1 diabetes",
        (63.0, 140.0),
        _PREGNANCY,
        {
            "time_above_140_pct": _Goal(25.0),
            "time_63_140_pct": _Goal(70.0, more=True),
            "time_below_63_pct": _Goal(4.0),
            "time_below_54_pct": _Goal(1.0),
        },
    ),
}
"""Ranges and goals of the consensus of 2019."""
