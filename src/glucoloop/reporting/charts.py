"""Pictures over time as plain data, which ``pages/data.mjs`` reads and ``pages/chart.mjs`` draws.

Times are whole tenths of a minute and values whole steps of their quantity; of both, the differences are written.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glucoloop.display_units import other_value, shown_unit

Floats = npt.NDArray[np.float64]

_T_STEP: Final = 0.1
"""Resolution of times in min; no sample time is a part of one."""


class PlottedQuantity(NamedTuple):
    """A quantity over time, with a second unit of which `factor` are in its own; values have the resolution `step`."""

    name: str
    unit: str
    other: str
    factor: float
    step: float
    digits: int


GLUCOSE: Final = PlottedQuantity("Glucose", "mg/dl", "mmol/l", other_value(1.0, "mg/dl"), 0.1, 1)
INSULIN: Final = PlottedQuantity("Insulin", "mU/min", "U/h", other_value(1.0, "mU/min"), 0.01, 2)
TIME_IN_RANGE: Final = PlottedQuantity("Time in range", "%", "", 0.0, 0.1, 1)
BOLUS: Final = PlottedQuantity("Boluses", "U", "", 0.0, 0.01, 2)
INSULIN_ON_BOARD: Final = PlottedQuantity("Insulin on board", "U", "", 0.0, 0.01, 2)
CARBS_ON_BOARD: Final = PlottedQuantity("Carbohydrate on board", "g", "", 0.0, 0.1, 1)
GLUCAGON: Final = PlottedQuantity("Glucagon", "ug", "", 0.0, 0.1, 1)


@dataclass
class Panel:
    """One quantity over time; spans of time lie below levels, and both below curves."""

    quantity: PlottedQuantity
    range: tuple[float, float]
    height: int
    """Height of the panel in pixels."""
    marks: Sequence[tuple[float, str]] = ()
    """Times in min and texts above the upper edge."""
    band: tuple[float, float] | None = None
    """Range that is aimed at."""
    spans: list[tuple[float, float]] = field(default_factory=list)
    """Times that are shaded."""
    rules: list[dict[str, Any]] = field(default_factory=list)
    """Horizontal lines, with their words in a legend."""
    lines: list[dict[str, Any]] = field(default_factory=list)
    areas: list[dict[str, Any]] = field(default_factory=list)
    dots: list[dict[str, Any]] = field(default_factory=list)

    def line(self, t_min: npt.ArrayLike, values: npt.ArrayLike, colour: int, **about: Any) -> None:
        """Draw a curve, with gaps where values are not finite; one without a name is only seen, never told.

        If there is one more time than values, these are held until the next, and the last until the last time.
        `about` has its name, the number of its `dash`, its `kind` of line, and whose it is: a `run` or a `person`.
        """
        t, y = np.asarray(t_min, float), np.asarray(values, float)
        if t.size > y.size:
            changes = np.append(np.flatnonzero(np.diff(y, prepend=np.nan) != 0.0), y.size)
            t, y = t[changes], y[changes[:-1]]
        look = {"name": "", "kind": "line", "dash": 0, "colour": colour}
        self.lines.append({**look, **about, "t": _differences(t, _T_STEP), "y": self._whole(y)})

    def area(self, t_min: npt.ArrayLike, low: npt.ArrayLike, high: npt.ArrayLike, colour: int, name: str) -> None:
        """Fill between two curves, unless nowhere there is anything between them; values are held as those of lines."""
        below, above = np.asarray(low, float), np.asarray(high, float)
        finite = np.isfinite(below) & np.isfinite(above)
        if np.any(above[finite] > below[finite]):
            t = _differences(np.asarray(t_min, float), _T_STEP)
            edges = {"low": self._whole(below), "high": self._whole(above)}
            self.areas.append({"name": name, "colour": colour, "t": t, **edges})

    def dot(self, t_min: npt.ArrayLike, values: npt.ArrayLike, colour: int, run: int) -> None:
        """Draw a dot at each time and value."""
        places = {"t": _differences(np.asarray(t_min, float), _T_STEP), "y": self._whole(np.asarray(values, float))}
        self.dots.append({"colour": colour, "run": run, **places})

    def rule(self, values: Iterable[float], dash: int, text: str) -> None:
        """Draw horizontal lines, which a text names in a legend."""
        self.rules.append({"values": list(dict.fromkeys(values)), "dash": dash, "text": text})

    def _whole(self, values: Floats) -> list[int | None]:
        return _differences(values, self.quantity.step)

    def data(self) -> dict[str, Any]:
        """Plain values for JSON, in the unit that is shown; the other unit has the axis on the right."""
        of, results = self.quantity, {**asdict(self), **self.quantity._asdict()}
        if shown_unit(of.unit) == of.unit:
            return results
        rules = [{**rule, "values": [of.factor * value for value in rule["values"]]} for rule in self.rules]
        scaled = {
            name: None if ends is None else [of.factor * end for end in ends]
            for name, ends in (("range", self.range), ("band", self.band))
        }
        units = {"unit": of.other, "other": of.unit, "factor": 1.0 / of.factor}
        return {**results, **scaled, **units, "rules": rules, "step": of.factor * of.step, "digits": of.digits + 1}


def _differences(values: Floats, step: float) -> list[int | None]:
    """Values in whole steps, each less the one before; None for what is not finite."""
    whole: list[int | None] = [None] * values.size
    finite = np.flatnonzero(np.isfinite(values))
    for place, difference in zip(finite, np.diff(np.rint(values[finite] / step), prepend=0.0), strict=True):
        whole[place] = int(difference)
    return whole


def extent(*series: npt.ArrayLike) -> tuple[float, float]:
    """Minimum and maximum finite value of arrays, at least one apart."""
    values = np.concatenate([np.ravel(np.asarray(part, float)) for part in series])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    return low, max(high, low + 1.0)


def thinned(t_min: npt.ArrayLike, values: npt.ArrayLike, most: int) -> tuple[Floats, Floats]:
    """Points of a curve, about `most` at most, among them the minimum and the maximum of each stretch of it."""
    t, y = np.asarray(t_min, float), np.asarray(values, float)
    if t.size <= most:
        return t, y
    places = {0, t.size - 1}
    for part in np.array_split(np.arange(t.size), max(1, most // 2)):
        finite = part[np.isfinite(y[part])]
        places |= {int(finite[y[finite].argmin()]), int(finite[y[finite].argmax()])} if finite.size else {int(part[0])}
    chosen = sorted(places)
    return t[chosen], y[chosen]


class Plot(NamedTuple):
    """Panels above each other, and lanes below them, with one axis of time."""

    name: str
    end_min: float
    panels: Sequence[Panel]
    lanes: Sequence[Mapping[str, Any]] = ()
    """Lines of time: a `name`, and `rows`, each with its `periods` in min and its `colour`."""
    start_min: float = 0.0
    """Time of day at the start, after midnight."""

    def data(self) -> dict[str, Any]:
        """Plain values for JSON."""
        panels = [panel.data() for panel in self.panels]
        return {"name": self.name, "end": self.end_min, "start": self.start_min, "panels": panels, "lanes": self.lanes}
