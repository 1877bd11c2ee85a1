"""Figure of a trial, ready for print: response bands, the control-variability grid and the time in range."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from glucoloop.metrics import TARGET_RANGE_MG_DL
from glucoloop.metrics.control_variability import (
    CELLS,
    MAXIMUM_LIMITS_MG_DL,
    MINIMUM_LIMITS_MG_DL,
    region_pct,
    zone_pct,
)
from glucoloop.reporting import _style
from glucoloop.reporting._style import FONT_PT, GREY, RANGE_COLOURS, ZONE_COLOURS, Width
from glucoloop.reporting.charts import extent
from glucoloop.studies.trial.report import RANGES, CaseReport, TrialReport
from glucoloop.text import percent
from glucoloop.units import MIN_PER_DAY, u_h_from_mu_min

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS: Final = {"single": 2, "double": 4}
_GLUCOSE_MM: Final = 34.0
_INSULIN_MM: Final = 24.0
_BAR_MM: Final = 8.5
_CHARACTER_MM: Final = 1.7  # of the font's boldest
_AROUND_MM: Final = 30.0  # title, legend and the axis of the bars
_MIN_SHARE_WRITTEN: Final = 7.0  # percent of a bar that has room for its own number
_BANDS: Final = ((0.01, 0.99, 0.13), (0.05, 0.95, 0.22), (0.25, 0.75, 0.36))
"""Lower and upper quantile of each band, and its opacity."""


def plot_trial(report: TrialReport, *, title: str | None = None, width: Width = "double") -> Figure:
    """Draw a trial: for each controller the bands of glucose and insulin and the grid, and the times in range below.

    Bands hold the middle 50, 90 and 98 % of the people at each moment, on axes that all controllers share. Rates of
    subcutaneous insulin are in U/h, with the range from 70 to 180 mg/dl and planned meals; its days are by the clock.
    In the grid each person is counted at the minimum and the maximum glucose, the colour on a logarithmic scale.

    Parameters
    ----------
    title : str, optional
        Title; that of the report if not given, none if empty.
    width : {"single", "double"}
        Width of a printed column: 88 or 180 mm.

    Returns
    -------
    matplotlib.figure.Figure
        Figure outside pyplot's state; write it with ``savefig`` to SVG, PDF or PNG (300 dots per inch).
    """
    number = len(report.cases)
    figure, panels, columns = _sheet(number, report.title if title is None else title, width)
    characters = max(12, int(_style.PANEL_SHARE * _style.WIDTHS_MM[width] / columns / _CHARACTER_MM))
    divisor, unit, tick = _style.time_axis(report.horizon_min, "single")
    cases = report.cases.values()
    bounds = TARGET_RANGE_MG_DL if report.subcutaneous else (report.lowest_glucose_mg_dl,)
    rate, rate_unit = (u_h_from_mu_min(1.0), "U/h") if report.subcutaneous else (1.0, "mU/min")
    in_days = report.subcutaneous and report.horizon_min > MIN_PER_DAY
    levels = [report.setpoint_mg_dl, *bounds]
    low, high = extent(levels, *(case.glucose_quantiles[quantile] for case in cases for quantile in (0.01, 0.99)))
    _, most = extent([0.0], *(rate * case.insulin_quantiles[0.99] for case in cases))
    for index, (label, case) in enumerate(report.cases.items()):
        glucose, insulin, grid = (panels[f"{kind} {index}"] for kind in ("glucose", "insulin", "grid"))
        style = {"color": _style.line_style(index)["color"], "linewidth": 1.1}
        steps_t = np.append(case.insulin_t_min, case.bands_t_min[-1])
        stepwise = {
            quantile: rate * np.append(values, values[-1:]) for quantile, values in case.insulin_quantiles.items()
        }
        for axes, t_min, quantiles in (
            (glucose, case.bands_t_min, case.glucose_quantiles),
            (insulin, steps_t, stepwise),
        ):
            bands = [(quantiles[below], quantiles[above], opacity) for below, above, opacity in _BANDS]
            _style.draw_bands(axes, t_min / divisor, bands, quantiles[0.5], style, stepwise=axes is insulin)
            axes.set_xlim(0.0, report.horizon_min / divisor)
            axes.xaxis.set_major_locator(_style.every(tick))
            if in_days:
                _style.show_clock(axes, report.start_min, report.horizon_min, "single")
        setpoint = glucose.axhline(report.setpoint_mg_dl, **_style.SETPOINT, zorder=4)
        if report.subcutaneous:
            meals_t = np.array([t_min for t_min, _ in report.meals if t_min < report.horizon_min])
            _style.mark_times(glucose, meals_t / divisor)
            bound: Artist = glucose.axhspan(*TARGET_RANGE_MG_DL, **_style.TARGET_RANGE)
        else:
            bound = glucose.axhline(report.lowest_glucose_mg_dl, **_style.BOUND, zorder=4)
        _draw_grid(grid, case, style["color"], characters)
        for axes in (glucose, grid):
            heading = _style.literal(textwrap.fill(label, characters))
            axes.set_title(heading, fontsize=FONT_PT, fontweight="bold", loc="left")
        glucose.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
        glucose.tick_params(labelbottom=False)
        glucose.set_xlabel("")
        insulin.set(ylim=(0.0, 1.05 * most), xlabel="Time of day" if in_days else f"Time ({unit})")
        for axes, name in (
            (glucose, "Glucose (mg/dl)"),
            (insulin, f"Insulin ({rate_unit})"),
            (grid, "Maximum (mg/dl)"),
        ):
            axes.set_ylabel(name, visible=index % columns == 0)
            axes.tick_params(labelleft=index % columns == 0)
    entries = _legend_of_bands()
    entries[f"setpoint {report.setpoint_mg_dl:g} mg/dl"] = setpoint
    words = "{:g} to {:g} mg/dl" if report.subcutaneous else "lowest allowed {:g} mg/dl"
    entries[words.format(*bounds)] = bound
    _draw_ranges(panels["bars"], report, entries, width)
    _style.dress(*panels.values())
    figure.align_ylabels([axes for name, axes in panels.items() if name != "bars"])
    _style.add_legend(figure, entries, width)
    return figure


def _sheet(people: int, title: str, width: Width) -> tuple[Figure, dict[str, Axes], int]:
    """Empty figure with as many rows of panels as the controllers need, and the bars below; its number of columns."""
    rows = -(-people // _COLUMNS.get(width, 1))
    columns = -(-people // rows)
    grid_mm = min(48.0, _style.PANEL_SHARE * _style.WIDTHS_MM.get(width, 0.0) / columns)
    heights = [_GLUCOSE_MM, _INSULIN_MM] * rows + [grid_mm] * rows + [_BAR_MM * people]
    figure = _style.new_figure(width, sum(heights) + 6.0 * len(heights) + _AROUND_MM, title)
    places = [range(columns * row, columns * (row + 1)) for row in range(rows)]
    kinds = [(kind, row) for row in places for kind in ("glucose", "insulin")] + [("grid", row) for row in places]
    lines = [[f"{kind} {index}" if index < people else "." for index in row] for kind, row in kinds]
    mosaic: Any = [*lines, ["bars"] * columns]
    return figure, figure.subplot_mosaic(mosaic, height_ratios=heights), columns


def _legend_of_bands() -> dict[str, Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: dict[str, Artist] = {"median": Line2D([], [], color=GREY, linewidth=1.1)}
    # a band lies over the wider ones
    transparency = 1.0
    for low, high, opacity in _BANDS:
        transparency *= 1.0 - opacity
        entries[f"middle {100 * (high - low):.0f} %"] = Patch(facecolor="0.2", alpha=1.0 - transparency, linewidth=0.0)
    return entries


def _draw_grid(axes: Axes, case: CaseReport, colour: str, characters: int) -> None:
    from matplotlib.colors import LinearSegmentedColormap, LogNorm, to_rgba
    from matplotlib.patches import Rectangle

    for number, region in enumerate(region_pct(case.cvga_counts)):
        corner = (CELLS * (number // 3), CELLS * (number % 3))
        tint = (ZONE_COLOURS[region[-1]], 0.16)
        axes.add_patch(Rectangle(corner, CELLS, CELLS, facecolor=tint, edgecolor=GREY, linewidth=0.5, zorder=1))
        place = (corner[0] + CELLS - 1.0, corner[1] + CELLS - 1.0)
        _style.write(axes, region[-1], place, ha="left", va="top", zorder=4)
    counts = np.ma.masked_less(np.asarray(case.cvga_counts, float).T, 0.5)
    colours = LinearSegmentedColormap.from_list("people", [to_rgba(colour, 0.3), to_rgba(colour, 1.0)])
    edges = np.arange(3 * CELLS + 1)
    top = max(10.0, float(counts.max() or 1.0)) if counts.count() else 10.0
    axes.pcolormesh(edges, edges, counts, cmap=colours, norm=LogNorm(1.0, top), zorder=2, rasterized=True)
    axes.spines[:].set_visible(False)
    ticks = np.arange(0, 3 * CELLS + 1, CELLS)
    axes.set_xticks(ticks, [f"{limit:g}" for limit in MINIMUM_LIMITS_MG_DL])
    axes.set_yticks(ticks, [f"{limit:g}" for limit in MAXIMUM_LIMITS_MG_DL])
    axes.set(box_aspect=1.0, anchor="W", xlim=(3 * CELLS, 0), ylim=(0, 3 * CELLS))
    shares = [
        f"{zone}\N{NO-BREAK SPACE}{percent(share)}"
        for zone, share in zone_pct(case.cvga_counts).items()
        if share != 0.0
    ]
    text = textwrap.fill(", ".join(shares), characters, break_on_hyphens=False, break_long_words=False)
    axes.set_xlabel(f"Minimum (mg/dl)\n{text}")


def _draw_ranges(axes: Axes, report: TrialReport, entries: dict[str, Artist], width: Width) -> None:
    # beside the times that stand on the right, where there is room for them
    room = int(_style.WIDTHS_MM[width] / _CHARACTER_MM * (0.5 if width == "double" else 0.9))
    for index, (label, case) in enumerate(report.cases.items()):
        times = [float(case.time_in_range_pct[name]) for name in RANGES]
        left = 0.0
        for name, time in zip(RANGES, times, strict=True):
            bar = axes.barh(index, time, left=left, height=0.42, color=RANGE_COLOURS[name], linewidth=0.0)
            entries.setdefault(f"{name} mg/dl", bar[0])
            if time >= _MIN_SHARE_WRITTEN:
                _style.write(axes, percent(time), (left + time / 2.0, index), va="center_baseline")
            left += time
        name = _style.literal(label if len(label) <= room else label[: room - 1] + "…")
        _style.write(axes, name, (0.0, index - 0.26), ha="left", fontweight="bold")
        if width == "double":
            beyond = f"below 70 mg/dl: {percent(sum(times[:2]))}   above 180 mg/dl: {percent(sum(times[3:]))}"
            _style.write(axes, beyond, (100.0, index - 0.26), ha="right")
    axes.spines["left"].set_visible(False)
    axes.set(xlim=(0.0, 100.0), ylim=(len(report.cases) - 0.7, -0.75), yticks=[])
    axes.set_xlabel("Time in range, mean over the people (%)")
