"""Charts of pages: curves over time as SVG that is stretched to the page, which ``templates/charts.html`` writes.

The points of a path are the data: times in tenths of a minute and values in steps of their quantity, both whole
numbers, each point relative to the one before. ``page.js`` reads them there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glucoloop.report._style import time_axis
from glucoloop.report.validity import stretches
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_H, MU_PER_U

Floats = npt.NDArray[np.float64]

Lane = tuple[str, Sequence[tuple[Sequence[tuple[float, float]], str]]]
"""Title of a line of time, and its rows: periods in min, and the class of their colour."""

PER_MIN: Final = 10
"""Number of units of the horizontal axis of a path in a minute; no sample time is a part of one."""
_COLOURS: Final = 6
"""Number of colours of runs in ``page.css``."""
_DASHES: Final = 5
_TICK_REM: Final = 1.9
"""Least distance of two ticks."""


class PlottedQuantity(NamedTuple):
    """A quantity over time, with a second unit of which `factor` are in its own; paths have the resolution `step`."""

    name: str
    unit: str
    other_unit: str
    factor: float
    step: float
    digits: int


GLUCOSE: Final = PlottedQuantity("Glucose", "mg/dl", "mmol/l", 1.0 / MG_DL_PER_MMOL_L, 0.1, 1)
INSULIN: Final = PlottedQuantity("Insulin", "mU/min", "U/h", MIN_PER_H / MU_PER_U, 0.01, 2)
BOLUS: Final = PlottedQuantity("Boluses", "U", "", 0.0, 0.01, 2)


@dataclass(frozen=True)
class TimeAxis:
    """Time from 0 on, which plots share."""

    end_min: float

    @property
    def end(self) -> int:
        """The end, in the units of paths."""
        return self.across(self.end_min)

    @property
    def scale(self) -> tuple[float, str, list[tuple[float, str]]]:
        """Number of minutes in the unit of the axis, the unit, and the ticks: times in min and their texts."""
        divisor, unit, tick = time_axis(self.end_min, "double")
        numbers = np.arange(0.0, self.end_min / divisor + 1e-9, tick)
        return divisor, unit, [(at * divisor, f"{at:g}") for at in numbers]

    def across(self, t_min: float) -> int:
        """A time in the units of paths."""
        return round(t_min * PER_MIN)

    def percent(self, t_min: float) -> str:
        """Place of a time, from the left."""
        return f"{100.0 * t_min / self.end_min:.4g}"


class PlottedCurve(NamedTuple):
    """A line, a band, or dots; `kind` are its classes of style, and one without a name is only seen, never told."""

    path: str
    kind: str
    name: str | None = None
    person: int | None = None
    band: bool = False


@dataclass
class Panel:
    """One quantity over time; areas lie below levels, and both below curves."""

    quantity: PlottedQuantity
    time: TimeAxis
    low: float
    high: float
    rem: float
    """Height of the panel."""
    alt: str
    """Text in place of the picture."""
    marks: Sequence[tuple[float, str]] = ()
    """Times in min and texts above the upper edge."""
    areas: list[tuple[str, int, int, int, int]] = field(default_factory=list)
    """Class, corner, width and height of rectangles."""
    levels: list[tuple[str, int]] = field(default_factory=list)
    """Class and place of horizontal lines."""
    curves: list[PlottedCurve] = field(default_factory=list)
    legend: list[tuple[str, str]] = field(default_factory=list)
    """Class and words of the horizontal lines."""

    def line(self, t_min: npt.ArrayLike, values: npt.ArrayLike, kind: str, **named: Any) -> None:
        """Draw a curve, with gaps where values are not finite; `named` as for `PlottedCurve`."""
        self.curves.append(PlottedCurve(self._path(np.asarray(t_min), np.asarray(values)), kind, **named))

    def steps(self, t_min: npt.ArrayLike, values: npt.ArrayLike, kind: str, **named: Any) -> None:
        """Draw values that are held until the next time; the last time ends the last one."""
        t, held = _held(t_min, values)
        same = np.diff(held) == 0.0
        corner = ~np.pad(same[1:] & same[:-1], 1) if held.size > 1 else np.ones(held.shape, bool)
        self.line(t[corner], held[corner], kind, **named)

    def band(
        self, t_min: npt.ArrayLike, low: npt.ArrayLike, high: npt.ArrayLike, kind: str, name: str, *, held: bool = False
    ) -> None:
        """Fill between two curves, unless nowhere there is anything between them."""
        t, below, above = (np.asarray(part, float) for part in (t_min, low, high))
        if held:
            (_, below), (t, above) = _held(t, below), _held(t, above)
        finite = np.isfinite(below) & np.isfinite(above)
        if not np.any(above[finite] > below[finite]):
            return
        t, below, above = t[finite], below[finite], above[finite]
        path = self._path(np.concatenate([t, t[::-1]]), np.concatenate([above, below[::-1]]))
        self.curves.append(PlottedCurve(path, kind, name, band=True))

    def level(self, values: Iterable[float], kind: str, text: str = "") -> None:
        """Draw horizontal lines, which `words` name in a legend."""
        self.levels += [(kind, self.up(value)) for value in dict.fromkeys(values)]
        self.legend.append((kind, text))

    def area(self, kind: str, t_min: tuple[float, float], values: tuple[float, float]) -> None:
        """Fill a rectangle, below those that are there."""
        (x, right), (y, top) = map(self.time.across, t_min), map(self.up, values)
        self.areas.insert(0, (kind, x, y, right - x, top - y))

    def up(self, value: float) -> int:
        """A value in the units of paths."""
        return round(value / self.quantity.step)

    def _path(self, t_min: Floats, values: Floats) -> str:
        points = np.column_stack([np.asarray(t_min, float) * PER_MIN, np.asarray(values, float) / self.quantity.step])
        parts = []
        for start, end in stretches(np.isfinite(points[:, 1])):
            whole = np.rint(points[start:end]).astype(np.int64)
            moves = " ".join(f"{right} {up}" for right, up in np.diff(whole, axis=0).tolist())
            # a point alone is seen by its round ends
            parts.append(f"M{whole[0, 0]} {whole[0, 1]}l{moves.replace(' -', '-') or '0 0'}")
        return "".join(parts)

    def ticks(self, factor: float = 1.0) -> list[tuple[str, str, int]]:
        """Round values of a unit, `factor` in the quantity's own; places in percent from the top, and in paths."""
        levels = nice_ticks(self.low * factor, self.high * factor, int(self.rem / _TICK_REM))
        span = self.high - self.low
        return [(f"{at:g}", f"{100.0 * (self.high - at / factor) / span:.4g}", self.up(at / factor)) for at in levels]


def _held(t_min: npt.ArrayLike, values: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Corners of steps."""
    t = np.asarray(t_min, float)
    return np.repeat(t, 2)[1:-1], np.repeat(np.asarray(values, float)[: t.size - 1], 2)


def nice_ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers between two values, at most `most` of them."""
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * part for part in (1.0, 2.0, 2.5, 5.0, 10.0) if power * part >= rough * (1.0 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return [round(place * step, 10) for place in range(first, math.floor(high / step + 1e-9) + 1)]


def extent(*shown: npt.ArrayLike) -> tuple[float, float]:
    """Least and greatest finite value of arrays, at least one apart."""
    values = np.concatenate([np.ravel(np.asarray(part, float)) for part in shown])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    return low, max(high, low + 1.0)


def thinned(t_min: npt.ArrayLike, values: npt.ArrayLike, most: int) -> tuple[Floats, Floats]:
    """Points of a curve, about `most` at most, among them the least and the greatest of each stretch of it."""
    t, y = np.asarray(t_min, float), np.asarray(values, float)
    if t.size <= most:
        return t, y
    places = {0, t.size - 1}
    for part in np.array_split(np.arange(t.size), max(1, most // 2)):
        finite = part[np.isfinite(y[part])]
        places |= {int(finite[y[finite].argmin()]), int(finite[y[finite].argmax()])} if finite.size else {int(part[0])}
    chosen = sorted(places)
    return t[chosen], y[chosen]


def looks(index: int) -> str:
    """Classes of the dashes and the colour of a run."""
    return f"dash-{index % _DASHES} {colour(index)}"


def colour(index: int) -> str:
    """Class of the colour of a run."""
    return f"colour-{index % _COLOURS}"


class Plot(NamedTuple):
    """Panels above each other, and lanes below them, with one axis of time."""

    name: str
    panels: Sequence[Panel]
    lanes: Sequence[Lane] = ()
