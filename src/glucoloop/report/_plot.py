"""Plots of pages: curves over time as SVG that is stretched to the page, with words and numbers as HTML around it.

The points of a path are the data: times in tenths of a minute and values in steps of their quantity, both whole
numbers, each point relative to the one before. ``page.js`` reads them there.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from glucoloop.report._style import time_axis
from glucoloop.units import MG_DL_PER_MMOL_L, MIN_PER_H, MU_PER_U

Floats = npt.NDArray[np.float64]

PER_MIN: Final = 10
"""Number of units of the horizontal axis of a path in a minute; no sample time is a part of one."""
COLOURS: Final = 6
"""Number of colours of runs in ``page.css``."""
_DASHES: Final = 5
_TICK_REM: Final = 1.9
"""Least distance of two ticks."""
_MOST_MARK_TEXTS: Final = 24


@dataclass(frozen=True)
class PlottedQuantity:
    """A quantity over time, with its unit and a second one."""

    name: str
    unit: str
    other_unit: str
    factor: float
    """Number of other units in a unit."""
    step: float
    """Resolution of the path."""
    digits: int


GLUCOSE: Final = PlottedQuantity("Glucose", "mg/dl", "mmol/l", 1.0 / MG_DL_PER_MMOL_L, 0.1, 1)
INSULIN: Final = PlottedQuantity("Insulin", "mU/min", "U/h", MIN_PER_H / MU_PER_U, 0.01, 2)
BOLUS: Final = PlottedQuantity("Boluses", "U", "", 0.0, 0.01, 2)


@dataclass
class Panel:
    """One quantity over time; shapes are drawn in their order."""

    quantity: PlottedQuantity
    low: float
    high: float
    rem: float
    """Height of the panel."""
    alt: str
    """Text in place of the picture."""
    shapes: list[str] = field(default_factory=list)
    marks: Sequence[tuple[float, str]] = ()
    """Times in min and texts above the upper edge."""

    def line(self, t_min: npt.ArrayLike, values: npt.ArrayLike, attributes: str) -> None:
        """Draw a curve, with gaps where values are not finite; `attributes` are those of the SVG element."""
        self.shapes.append(f'<path {attributes} d="{self._path(np.asarray(t_min), np.asarray(values))}"/>')

    def steps(self, t_min: npt.ArrayLike, values: npt.ArrayLike, attributes: str) -> None:
        """Draw values that are held until the next time; the last time ends the last one."""
        t, held = (
            np.repeat(np.asarray(t_min, float), 2)[1:-1],
            np.repeat(np.asarray(values, float)[: np.size(t_min) - 1], 2),
        )
        self.line(*_without_middles(t, held), attributes)

    def band(
        self, t_min: npt.ArrayLike, low: npt.ArrayLike, high: npt.ArrayLike, attributes: str, *, held: bool = False
    ) -> None:
        """Fill between two curves, unless nowhere there is anything between them."""
        t, below, above = (np.asarray(part, float) for part in (t_min, low, high))
        if held:
            t = np.repeat(t, 2)[1:-1]
            below, above = (np.repeat(part[: np.size(t_min) - 1], 2) for part in (below, above))
        finite = np.isfinite(below) & np.isfinite(above)
        if not np.any(above[finite] > below[finite]):
            return
        t, below, above = t[finite], below[finite], above[finite]
        path = self._path(np.concatenate([t, t[::-1]]), np.concatenate([above, below[::-1]]))
        self.shapes.append(f'<path data-kind="band" {attributes} d="{path}"/>')

    def level(self, value: float, end_min: float, kind: str = "level") -> None:
        """Draw a horizontal line."""
        y = round(value / self.quantity.step)
        self.shapes.append(f'<line class="{kind}" x1="0" x2="{round(end_min * PER_MIN)}" y1="{y}" y2="{y}"/>')

    def area(self, kind: str, t_min: tuple[float, float], values: tuple[float, float]) -> None:
        """Fill a rectangle."""
        x, right = (round(t * PER_MIN) for t in t_min)
        y, top = (round(value / self.quantity.step) for value in values)
        self.shapes.append(f'<rect class="{kind}" x="{x}" y="{y}" width="{right - x}" height="{top - y}"/>')

    def _path(self, t_min: Floats, values: Floats) -> str:
        x = np.rint(np.asarray(t_min, float) * PER_MIN)
        y = np.asarray(values, float) / self.quantity.step
        finite = np.isfinite(y)
        starts = np.flatnonzero(finite & ~np.concatenate([[False], finite[:-1]]))
        ends = np.flatnonzero(finite & ~np.concatenate([finite[1:], [False]])) + 1
        parts = []
        for start, end in zip(starts, ends, strict=True):
            points = np.rint(np.column_stack([x[start:end], y[start:end]])).astype(np.int64)
            moves = np.diff(points, axis=0)
            first, *rest = points[0].tolist()
            told = f"M{first} {rest[0]}"
            if len(moves):
                told += "l" + " ".join(f"{dx} {dy}" for dx, dy in moves.tolist()).replace(" -", "-")
            parts.append(told if len(moves) else told + "l0 0")  # a point alone is seen by its round ends
        return "".join(parts)

    def html(self, end_min: float) -> str:
        """HTML of the panel."""
        quantity = self.quantity
        most = int(self.rem / _TICK_REM)
        levels = nice_ticks(self.low, self.high, most)
        across = round(end_min * PER_MIN)
        lines = "".join(f"M0 {round(level / quantity.step)}h{across}" for level in levels)
        top, height = round(self.high / quantity.step), round((self.high - self.low) / quantity.step)
        many = " many" * (len(self.marks) > _MOST_MARK_TEXTS)
        marks = "".join(
            f'<span class="mark{many}" {_at(t, end_min)}>{html.escape(text)}</span>' for t, text in self.marks
        )
        data = f'data-step="{quantity.step:g}" data-unit="{quantity.unit}" data-digits="{quantity.digits}"'
        if quantity.other_unit:
            data += f' data-other="{quantity.other_unit}" data-factor="{quantity.factor:.8g}"'
        other_span = self.low * quantity.factor, self.high * quantity.factor
        other = nice_ticks(*other_span, most) if quantity.other_unit else []
        return (
            f'<div class="axes"><span>{quantity.name} ({quantity.unit})</span>'
            f"<span>{f'({quantity.other_unit})' if quantity.other_unit else ''}</span></div>\n"
            f'<div class="panel" {data}><div class="ticks" aria-hidden="true">{self._ticks(levels, 1.0)}</div>'
            f'<div class="field{" marked" * bool(self.marks)}" style="--height: {self.rem:g}rem">'
            f'<svg role="img" aria-label="{html.escape(self.alt)}" '
            f'viewBox="0 {-top} {across} {height}" preserveAspectRatio="none">'
            f'<g transform="scale(1 -1)"><path class="grid" d="{lines}"/>{"".join(self.shapes)}</g></svg>{marks}</div>'
            f'<div class="ticks" aria-hidden="true">{self._ticks(other, quantity.factor)}</div></div>'
        )

    def _ticks(self, levels: Iterable[float], factor: float) -> str:
        return "".join(
            f'<span style="top: {100.0 * (self.high - level / factor) / (self.high - self.low):.4g}%">{level:g}</span>'
            for level in levels
        )


def _without_middles(t: Floats, held: Floats) -> tuple[Floats, Floats]:
    """Points of steps without those in the middle of a longer step."""
    same = np.diff(held) == 0.0
    middle = np.concatenate([[False], same[:-1] & same[1:], [False]]) if held.size > 1 else np.zeros(held.shape, bool)
    return t[~middle], held[~middle]


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
    kept = {0, t.size - 1}
    for part in np.array_split(np.arange(t.size), max(1, most // 2)):
        finite = part[np.isfinite(y[part])]
        kept |= {int(finite[y[finite].argmin()]), int(finite[y[finite].argmax()])} if finite.size else {int(part[0])}
    places = sorted(kept)
    return t[places], y[places]


def run_class(index: int) -> str:
    """CSS classes of a run: one of its own, and dashes."""
    return f"run-{index} dash-{index % _DASHES}"


def colour(index: int) -> str:
    """Colour of a run, as CSS."""
    return f"var(--run-{index % COLOURS})"


def swatch(attributes: str) -> str:
    """A short piece of a line for a legend."""
    return (
        '<svg class="swatch" aria-hidden="true" viewBox="0 0 10 10" preserveAspectRatio="none">'
        f'<path {attributes} d="M0 5L10 5"/></svg>'
    )


def _at(t_min: float, end_min: float) -> str:
    return f'data-t="{round(t_min * PER_MIN)}" style="left: {100.0 * t_min / end_min:.4g}%"'


def lane(title: str, rows: Sequence[tuple[Sequence[tuple[float, float]], str]], end_min: float) -> str:
    """A line of time with periods on it: rows of periods in min, each with its colour."""
    rects = "".join(
        f'<rect x="{round(start * PER_MIN)}" y="{row}.1" width="{max(1, round((stop - start) * PER_MIN))}" '
        f'height=".8" style="fill: {shade}"/>'
        for row, (periods, shade) in enumerate(rows)
        for start, stop in periods
    )
    return (
        f'<div class="lane"><p>{html.escape(title)}</p><div class="field" style="--height: {0.6 * len(rows):g}rem">'
        f'<svg aria-hidden="true" viewBox="0 0 {round(end_min * PER_MIN)} {len(rows)}" preserveAspectRatio="none">'
        f"{rects}</svg></div></div>"
    )


def plot(panels: Sequence[Panel], end_min: float, *, name: str, lanes: Sequence[str] = ()) -> str:
    """Panels above each other, with one axis of time."""
    divisor, unit, tick = time_axis(end_min, "double")
    times = "".join(
        f"<span {_at(at * divisor, end_min)}>{at:g}</span>" for at in np.arange(0.0, end_min / divisor + 1e-9, tick)
    )
    return (
        f'<figure class="plot" aria-label="{html.escape(name)}">\n'
        + "\n".join(panel.html(end_min) for panel in panels)
        + f'\n<div class="times" aria-hidden="true"><div>{times}</div></div>'
        f'<p class="time-unit">Time ({unit})</p>\n<div class="readout"></div>\n' + "\n".join(lanes) + "\n</figure>"
    )


def linked(figures: str, end_min: float, key: str, kind: str = "") -> str:
    """Plots whose moments and zoom go together, with the controls for both; `key` is unique on the page."""
    divisor, unit, _ = time_axis(end_min, "double")
    end = round(end_min * PER_MIN)
    buttons = "".join(
        f'<button type="button" data-does="{does}">{text}</button>'
        for does, text in (
            ("in", "Zoom in"),
            ("out", "Zoom out"),
            ("all", "Whole run"),
            ("save", "Save drawn data (CSV)"),
        )
    )
    return (
        f'<div class="linked {kind}" data-end="{end}" data-divisor="{divisor:g}" data-unit="{unit}">\n'
        f'<div class="controls"><label for="moment-{key}">Moment</label><input type="range" id="moment-{key}" min="0" '
        f'max="{end}" step="{PER_MIN}" value="0">{buttons}</div>\n{figures}\n</div>'
    )
