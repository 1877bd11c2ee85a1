"""Pictures of days of a record, for print and for pages: readings, and glucose of a twin with its band."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from glucoloop.display_units import other_value
from glucoloop.metrics import TARGET_RANGE_MG_DL
from glucoloop.reporting._style import (
    GREY,
    SETPOINT,
    add_axis,
    add_legend,
    dress,
    every,
    line_style,
    mark_meals,
    new_figure,
    time_axis,
)
from glucoloop.reporting.charts import GLUCOSE, Panel, Plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]

_LOWEST_MG_DL: Final = 40.0
_MIN_TOP_MG_DL: Final = 250.0
_LARGEST_MG_DL: Final = 400.0
_HEIGHT_MM: Final = 75.0


@dataclass(frozen=True, kw_only=True)
class DayTraces:
    """Readings of some days with trajectories beside them, at the same times."""

    first: dt.datetime
    """Local time of the minute 0."""
    t_min: Floats
    reading_mg_dl: Floats
    trajectory_mg_dl: Mapping[str, Floats]
    """Trajectories by name."""
    band_mg_dl: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict)
    """Bands of trajectories by the same names."""
    meals: Sequence[tuple[float, float]] = ()
    """Time and carbohydrate of meals."""

    @property
    def begins(self) -> str:
        """Date and time of the first reading."""
        return f"{self.first + dt.timedelta(minutes=float(self.t_min[0])):%Y-%m-%d %H:%M}"

    @property
    def marks(self) -> list[tuple[float, str]]:
        """Meals from the first reading on, as marks of a picture."""
        return [(float(t - self.t_min[0]), f"{carbs_g:.0f} g") for t, carbs_g in self.meals if t >= self.t_min[0]]

    @property
    def range_mg_dl(self) -> tuple[float, float]:
        """Ends of the axis of glucose."""
        tops = [self.reading_mg_dl, *self.trajectory_mg_dl.values(), *(high for _, high in self.band_mg_dl.values())]
        highest = max(float(np.nanmax(top)) for top in tops)
        return _LOWEST_MG_DL, min(_LARGEST_MG_DL, max(_MIN_TOP_MG_DL, 1.05 * highest))


def days_plot(days: DayTraces, band: str) -> Plot:
    """Picture of a page with the same days; `band` says what the bands hold."""
    start = days.t_min[0]
    t_min = days.t_min - start
    panel = Panel(GLUCOSE, days.range_mg_dl, height=330, band=TARGET_RANGE_MG_DL, marks=days.marks)
    for place, (name, trajectory) in enumerate(days.trajectory_mg_dl.items()):
        if name in days.band_mg_dl:
            panel.area(t_min, *days.band_mg_dl[name], place, f"{band}, {name}")
        panel.line(t_min, trajectory, place, name=name, dash=place)
    readings = len(days.trajectory_mg_dl)
    panel.line(t_min, days.reading_mg_dl, readings, name="readings", dash=readings)
    first = days.first + dt.timedelta(minutes=float(start))
    return Plot(f"Glucose from {days.begins}", float(t_min[-1]), [panel], start_min=60.0 * first.hour + first.minute)


def plot_days(days: DayTraces) -> Figure:
    """Draw readings as dots, and each trajectory as a line with its band."""
    t_min = days.t_min - days.t_min[0]
    divisor, unit, tick = time_axis(float(t_min[-1]), "double")
    figure = new_figure("double", _HEIGHT_MM, None)
    axes = figure.subplots()
    for bound in TARGET_RANGE_MG_DL:
        axes.axhline(bound, **SETPOINT)
    axes.plot(t_min / divisor, days.reading_mg_dl, ".", color=GREY, markersize=2.0, label="readings")
    for place, (name, trajectory) in enumerate(days.trajectory_mg_dl.items()):
        style = line_style(place)
        if name in days.band_mg_dl:
            low, high = days.band_mg_dl[name]
            axes.fill_between(t_min / divisor, low, high, color=style["color"], alpha=0.2, linewidth=0.0)
        axes.plot(t_min / divisor, trajectory, label=name, **style)
    axes.set(xlim=(0.0, t_min[-1] / divisor), ylim=days.range_mg_dl, ylabel="Glucose (mg/dl)")
    axes.set_xlabel(f"Time from {days.begins} ({unit})")
    axes.xaxis.set_major_locator(every(tick))
    meals = [(t - days.t_min[0], round(carbs_g)) for t, carbs_g in days.meals if t >= days.t_min[0]]
    mark_meals(axes, meals, float(t_min[-1]), "double")
    dress(axes)
    add_axis(axes, other_value(1.0, "mg/dl"), "(mmol/l)")
    lines, names = axes.get_legend_handles_labels()
    add_legend(figure, dict(zip(names, lines, strict=True)), "double")
    return figure
