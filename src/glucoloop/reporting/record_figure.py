"""Figure for print of records of glucose: percentiles over the day, and the time in each range."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from glucoloop.display_units import other_value
from glucoloop.metrics.readings.given import GLUCAGON
from glucoloop.reporting._style import (
    BOUND,
    FONT_PT,
    SETPOINT,
    add_axis,
    draw_bands,
    dress,
    every,
    line_style,
    literal,
    new_figure,
    write,
)
from glucoloop.reporting.record_groups import Goals, Reported
from glucoloop.reporting.record_page import MAX_IN_FULL, top_of_axis_mg_dl
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROW_MM: Final = 58.0
_MIN_WRITTEN_PCT: Final = 4.0
"""Minimum share of the bar that has room for its number."""


def plot_records(records: Sequence[Reported], goals: Goals) -> Figure:
    """Draw the first records or groups below each other, as a figure of the width of two columns.

    The line is the median, the bands hold 25 to 75 % and 5 to 95 % of the readings; the bar has the time in each range
    in percent.
    """
    first = records[:MAX_IN_FULL]
    figure = new_figure("double", _ROW_MM * len(first) + 6.0, None)
    rows = figure.subplots(len(first), 2, squeeze=False, width_ratios=[12.0, 1.0])
    top = max(top_of_axis_mg_dl(record.profile) for record in first)
    for record, (curves, bar) in zip(first, rows, strict=True):
        _draw_profile(curves, record, goals, top)
        _draw_bar(bar, record, goals)
    rows[-1][0].set_xlabel("Time of day (h)")
    return figure


def _draw_profile(axes: Axes, record: Reported, goals: Goals, top: float) -> None:
    profile = record.profile
    of = profile.percentiles_mg_dl
    axes.axhspan(*goals.target_mg_dl, color="#009E73", alpha=0.12, linewidth=0.0, zorder=0)
    for bound in (54.0, 250.0):
        axes.axhline(bound, **BOUND)
    for bound in goals.target_mg_dl:
        axes.axhline(bound, **SETPOINT)
    bands = [(of[5], of[95], 0.22), (of[25], of[75], 0.4)]
    draw_bands(axes, profile.t_min / MIN_PER_H, bands, of[50], line_style(0))
    axes.set(xlim=(0.0, 24.0), ylim=(40.0, top), ylabel="Glucose (mg/dl)")
    title = f"{record.label}, {record.dates}"
    glucagon_min = record.glucagon_ug.clock_min
    if glucagon_min.size:
        hours = glucagon_min % MIN_PER_DAY / MIN_PER_H
        edge = axes.get_xaxis_transform()
        axes.plot(hours, [0.96] * hours.size, "v", transform=edge, markersize=3.5, markeredgewidth=0, color="#444444")
        title += f"; triangles: glucagon, {record.numbers[GLUCAGON]:.0f} ug a day"
    axes.set_title(literal(title), fontsize=FONT_PT, loc="left")
    axes.xaxis.set_major_locator(every(3.0))
    dress(axes)
    add_axis(axes, other_value(1.0, "mg/dl"), "(mmol/l)")


def _draw_bar(axes: Axes, record: Reported, goals: Goals) -> None:
    below = 0.0
    for one in reversed(goals.ranges):
        share = record.numbers[one.result]
        axes.bar(0.0, share, bottom=below, width=0.8, color=one.colour)
        if share >= _MIN_WRITTEN_PCT:
            write(axes, f"{share:.0f} %", (0.0, below + share / 2.0), va="center")
        below += share
    axes.set(xlim=(-0.4, 0.4), ylim=(0.0, 100.0), xticks=[], yticks=[])
    axes.axis("off")
