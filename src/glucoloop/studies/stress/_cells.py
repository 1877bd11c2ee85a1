"""Text and shade of a cell of a stress test."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from glucoloop.printable import NOT_AVAILABLE, glucose_text
from glucoloop.studies.stress.stress import StressRow


def short_pct(value: float) -> str:
    """Text of a percentage in at most four characters; a small value is not rounded to 0, nor a large one to 100."""
    if not math.isfinite(value):
        return NOT_AVAILABLE
    if value in (0.0, 100.0):
        return f"{value:.0f}"
    if value < 0.05:
        return "<0.1"
    return "99.9" if value > 99.9 else f"{value:.1f}"


def short_mg_dl(value: float) -> str:
    """Text of a concentration, rounded to a whole number."""
    return glucose_text(value, 0)


@dataclass(frozen=True)
class Shade:
    """Shade of a cell of the map, by the time below 60 mg/dl of the person with the longest."""

    most_pct: float
    """Upper limit of the shade; the lower one is that of the shade before."""
    colour: str | None
    """Colour of the cell, or None for the background."""
    ink: str | None
    """Colour of text on it, or None for the usual one."""
    words: str


# Seven classes of "YlOrBr" without its palest: told apart by the colour-blind and in grey print (C. Brewer and
# M. Harrower, ColorBrewer, 2003).
_DARK, _LIGHT = "#1a1a1a", "#ffffff"
SHADES: Final = (
    Shade(0.0, None, None, "0 %"),
    Shade(1.0, "#fff8d0", _DARK, "to 1 %"),
    Shade(5.0, "#fee391", _DARK, "to 5 %"),
    Shade(10.0, "#fec44f", _DARK, "to 10 %"),
    Shade(20.0, "#fe9929", _DARK, "to 20 %"),
    Shade(40.0, "#cc4c02", _LIGHT, "to 40 %"),
    Shade(100.0, "#7a2604", _LIGHT, "above 40 %"),
)
UNKNOWN: Final = Shade(math.nan, "#b0b0b0", _DARK, NOT_AVAILABLE)


def shade_of(row: StressRow) -> Shade:
    """Shade of the cell of a row."""
    value = row.below_60_worst_pct
    return next((shade for shade in SHADES if value <= shade.most_pct), UNKNOWN if math.isnan(value) else SHADES[-1])


def legend_shades(rows: Iterable[StressRow]) -> list[Shade]:
    """Shades of the scale, and the one for unknown values if there are any."""
    unknown = any(shade_of(row) is UNKNOWN for row in rows)
    return [*SHADES, *([UNKNOWN] if unknown else [])]


@dataclass(frozen=True)
class RowQuantity:
    """One number of a row, with its heading and format."""

    group: str
    name: str
    of: Callable[[StressRow], str]


def _pct(name: str) -> Callable[[StressRow], str]:
    return lambda row: short_pct(float(getattr(row, name)))


def _mg_dl(name: str) -> Callable[[StressRow], str]:
    return lambda row: short_mg_dl(float(getattr(row, name)))


def _whole(name: str) -> Callable[[StressRow], str]:
    return lambda row: f"{int(getattr(row, name))}" if row.people else NOT_AVAILABLE


QUANTITIES: Final = (
    RowQuantity("Time below 60 (%)", "mean", _pct("below_60_mean_pct")),
    RowQuantity("Time below 60 (%)", "worst", _pct("below_60_worst_pct")),
    RowQuantity("Time below 54 (%)", "mean", _pct("below_54_mean_pct")),
    RowQuantity("Time below 54 (%)", "worst", _pct("below_54_worst_pct")),
    RowQuantity("Ever below (%)", "60", _pct("ever_below_60_pct")),
    RowQuantity("Ever below (%)", "54", _pct("ever_below_54_pct")),
    RowQuantity("Model not valid", "people", _whole("people_below_validity")),
    RowQuantity("Glucose (mg/dl)", "lowest", _mg_dl("lowest_mg_dl")),
    RowQuantity("Glucose (mg/dl)", "of person", _whole("lowest_person")),
    RowQuantity("Glucose (mg/dl)", "highest", _mg_dl("highest_mg_dl")),
    RowQuantity("Events", "low", _whole("low_events")),
    RowQuantity("Events", "very low", _whole("very_low_events")),
    RowQuantity("Samples (%)", "saturated", _pct("saturated_pct")),
    RowQuantity("Samples (%)", "missing", _pct("missing_pct")),
    RowQuantity("Samples (%)", "rejected", _pct("rejected_pct")),
    RowQuantity("Samples (%)", "fallback", _pct("fallback_pct")),
    RowQuantity("Samples (%)", "suspended", _pct("suspended_pct")),
    RowQuantity("Samples (%)", "limited", _pct("dose_limited_pct")),
    RowQuantity("Worse off", "people", lambda row: f"{len(row.worse)}" if row.people else NOT_AVAILABLE),
    RowQuantity("Worse off", "most (%)", _pct("worst_more_pct")),
)
"""All quantities of a cell, in order."""


def grouped() -> Iterator[tuple[str, list[RowQuantity]]]:
    """The quantities under the heads that they share."""
    for group in dict.fromkeys(quantity.group for quantity in QUANTITIES):
        yield group, [quantity for quantity in QUANTITIES if quantity.group == group]
