"""Style of figures: sizes of printed columns, colours that everyone can tell apart, and legible fonts."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import Locator

Width = Literal["single", "double"]

WIDTHS_MM: Final[dict[str, float]] = {"single": 88.0, "double": 180.0}
FONT_PT: Final = 7.0
_TITLE_PT: Final = 8.0
GREY: Final = "0.4"

# M. Okabe, K. Ito, "Color universal design", 2008; black is left for bounds, and yellow is too pale for a line.
OKABE_ITO: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
RANGE_COLOURS: Final = {
    "below 54": "#8C1D18",
    "54 to 70": "#DB5A4B",
    "70 to 180": "#7DBE93",
    "180 to 250": "#F0CE62",
    "above 250": "#D8923A",
}
"""Colours of the ranges of glucose."""
ZONE_COLOURS: Final = {"A": "#009E73", "B": "#56B4E9", "C": "#F0E442", "D": "#E69F00", "E": "#D55E00"}
"""Colours of the zones of the control-variability grid."""
# Dashes tell the lines apart in grey print. With one dash fewer than colours, 30 runs look different.
_DASHES: Final[tuple[Any, ...]] = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)))
# Horizontal lines.
SETPOINT: Final[dict[str, Any]] = {"color": GREY, "linewidth": 0.7}
BOUND: Final[dict[str, Any]] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (4, 3))}
TARGET_RANGE: Final[dict[str, Any]] = {
    "facecolor": RANGE_COLOURS["70 to 180"],
    "alpha": 0.22,
    "linewidth": 0,
    "zorder": 0,
}
BASAL: Final[dict[str, Any]] = {"color": GREY, "linewidth": 0.8, "linestyle": (0, (1, 1.5)), "zorder": 1}
FORECAST: Final[dict[str, Any]] = {"linewidth": 0.6, "alpha": 0.55, "zorder": 2.5}
ON_BOARD: Final[dict[str, Any]] = {"linewidth": 0.8, "linestyle": (0, (3, 1.5)), "alpha": 0.8, "zorder": 2.5}
PUMP_LIMIT: Final[dict[str, Any]] = {"color": "black", "linewidth": 0.6, "linestyle": (0, (6, 2, 1, 2)), "zorder": 1}

PANEL_SHARE: Final = 0.8
"""Share of a figure's width that panels fill; the rest holds ticks and labels."""
_LOOP_MM: Final = {"single": 95.0, "double": 115.0}
_LINE_MM: Final = 3.0  # a line of text, and about two of its characters
_MM_PER_INCH: Final = 25.4
_MAX_LEGEND_COLUMNS: Final = 4
_LEGEND_MM: Final = 14.0  # which a figure's height allows for
_LONGEST_IN_MINUTES: Final = 12 * MIN_PER_H
_MAX_TICK_STEPS: Final = {"single": 6, "double": 12}


def line_style(index: int) -> dict[str, Any]:
    """Colour and dashes of the curves of a run."""
    return {"color": OKABE_ITO[index % len(OKABE_ITO)], "linestyle": _DASHES[index % len(_DASHES)], "linewidth": 1.2}


def literal(text: str) -> str:
    """Text with dollar signs escaped, so that it is not read as mathematics."""
    return text.replace("$", r"\$")


def new_figure(width: Width, height_mm: float, title: str | None) -> Figure:
    """An empty figure of a column's width, its title wrapped; Refusal for an unknown width."""
    from glucoloop.reporting.print_figure import print_figure

    if width not in WIDTHS_MM:
        raise Refusal(f"unknown width {width!r}; use one of {', '.join(map(repr, WIDTHS_MM))}")
    size = (WIDTHS_MM[width] / _MM_PER_INCH, height_mm / _MM_PER_INCH)
    figure = print_figure(size)
    if title:
        figure.suptitle(literal(textwrap.fill(title, _characters(width, _TITLE_PT))), fontsize=_TITLE_PT)
    return figure


def loop_panels(
    horizon_min: float, title: str | None, width: Width, *, ratio: float
) -> tuple[Figure, Axes, Axes, float]:
    """Figure with glucose above insulin, so many times as high, on one axis of time, and the minutes of its unit."""
    figure = new_figure(width, _LOOP_MM.get(width, 0.0), title)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[ratio, 1.0])
    divisor, unit, tick = time_axis(horizon_min, width)
    above.set_ylabel("Glucose (mg/dl)")
    below.set(xlabel=f"Time ({unit})", ylabel="Insulin (mU/min)", xlim=(0.0, horizon_min / divisor))
    below.xaxis.set_major_locator(every(tick))
    dress(above, below)
    figure.align_ylabels([above, below])
    return figure, above, below, divisor


def mark_meals(axes: Axes, meals: Sequence[tuple[float, float]], horizon_min: float, width: Width) -> None:
    """Mark each meal at the upper edge with its carbohydrate above, rotated where meals are close."""
    if not meals:
        return
    divisor, upper_edge = time_axis(horizon_min, width)[0], axes.get_xaxis_transform()
    t_min = np.array([t for t, _ in meals])
    mark_times(axes, t_min / divisor)
    apart_mm = PANEL_SHARE * WIDTHS_MM[width] / horizon_min * np.diff(t_min).min(initial=np.inf)
    if apart_mm < _LINE_MM:
        return
    texts = [f"{carbs_g:.4g} g" for _, carbs_g in meals]
    upright = apart_mm < _LINE_MM / 2.0 * (max(map(len, texts)) + 1)
    for t, text in zip(t_min, texts, strict=True):
        write(axes, text, (t / divisor, 1.0), down=-4, xycoords=upper_edge, rotation=90 if upright else 0)


def mark_times(axes: Axes, t: npt.NDArray[np.float64]) -> None:
    """Mark times at the upper edge by triangles."""
    mark: dict[str, Any] = {"linestyle": "none", "marker": "v", "markersize": 4, "color": "black", "clip_on": False}
    axes.plot(t, np.ones_like(t), **mark, transform=axes.get_xaxis_transform())


def mark_exercise(axes: Axes, bouts: Sequence[Any], horizon_min: float, width: Width) -> None:
    """Mark each bout of exercise by a bar along the upper edge, with its intensity above."""
    divisor, upper_edge = time_axis(horizon_min, width)[0], axes.get_xaxis_transform()
    for bout in bouts:
        ends = bout.t_min / divisor, (bout.t_min + bout.duration_min) / divisor
        axes.plot(
            ends, (1.0, 1.0), linewidth=3.0, color=GREY, solid_capstyle="butt", clip_on=False, transform=upper_edge
        )
        write(axes, f"{bout.intensity_pct:.3g} %", (sum(ends) / 2.0, 1.0), down=-4, xycoords=upper_edge)


def _characters(width: Width, font_pt: float) -> int:
    """Number of characters that certainly fit side by side."""
    return int(WIDTHS_MM[width] / _MM_PER_INCH * 72.0 / (0.65 * font_pt))


def dress(*panels: Axes) -> None:
    """Style frame, ticks and fonts of panels."""
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
        for spine in axes.spines.values():
            spine.set_linewidth(0.6)
        axes.tick_params(labelsize=FONT_PT, width=0.6, length=2.5)
        axes.xaxis.label.set_fontsize(FONT_PT)
        axes.yaxis.label.set_fontsize(FONT_PT)


def add_axis(axes: Axes, factor: float, name: str) -> None:
    """Add a second axis on the right; a unit of the left axis is `factor` of its own."""

    def right_of(left: npt.ArrayLike) -> npt.NDArray[np.float64]:
        return np.asarray(left, float) * factor

    def left_of(right: npt.ArrayLike) -> npt.NDArray[np.float64]:
        return np.asarray(right, float) / factor

    right = axes.secondary_yaxis("right", functions=(right_of, left_of))
    right.set_ylabel(name)
    dress_right(right)


def dress_right(axes: Any) -> None:
    """Style an axis on the right."""
    axes.tick_params(labelsize=FONT_PT, width=0.6, length=2.5)
    axes.spines[["top"]].set_visible(False)
    axes.spines["right"].set_linewidth(0.6)
    axes.yaxis.label.set_fontsize(FONT_PT)


def write(axes: Axes, text: str, place: tuple[float, float], *, down: float = 0.0, **how: Any) -> None:
    """Write a text at a place, by default above it, and so many points further down."""
    style: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": FONT_PT, "xytext": (0, -down), **how}
    axes.annotate(text, place, textcoords="offset points", **style)


def draw_bands(
    axes: Axes,
    t: npt.ArrayLike,
    bands: Sequence[tuple[npt.ArrayLike, npt.ArrayLike, float]],
    median: npt.ArrayLike,
    style: Mapping[str, Any],
    *,
    stepwise: bool = False,
) -> list[Artist]:
    """Bands, each from a lower to an upper edge with its opacity, and the median over them; in steps if held."""
    step: Literal["post"] | None = "post" if stepwise else None
    artists: list[Artist] = [
        axes.fill_between(t, low, high, step=step, color=style["color"], alpha=opacity, linewidth=0.0, zorder=2)
        for low, high, opacity in bands
    ]
    return [*artists, *axes.plot(t, median, **style, drawstyle="steps-post" if stepwise else "default", zorder=3)]


def add_legend(figure: Figure, entries: Mapping[str, Artist], width: Width) -> None:
    """A legend below the panels, in as many columns as fit; a long one makes the figure higher."""
    # An empty prefix, since a label that begins with an underscore would be left out.
    room = _characters(width, FONT_PT) - 10
    texts = ["\u200b" * label.startswith("_") + textwrap.fill(literal(label), room) for label in entries]
    for columns in range(min(_MAX_LEGEND_COLUMNS, len(texts)), 0, -1):
        legend = figure.legend(
            list(entries.values()),
            texts,
            loc="outside lower center",
            ncols=columns,
            fontsize=FONT_PT,
            frameon=False,
            handlelength=2.6,
            columnspacing=1.4,
        )
        extent = legend.get_window_extent()
        if columns == 1 or extent.width <= figure.bbox.width:
            break
        legend.remove()
    beyond_inch = extent.height / figure.dpi - _LEGEND_MM / _MM_PER_INCH
    figure.set_figheight(figure.get_figheight() + max(0.0, beyond_inch))


def time_axis(horizon_min: float, width: Width) -> tuple[float, str, float]:
    """Number of minutes per unit of the time axis, the unit, and the distance of ticks in it.

    The unit is minutes up to twelve hours, hours up to a day, and days beyond.
    """
    steps: tuple[float, ...]
    if horizon_min <= _LONGEST_IN_MINUTES:
        divisor, unit, steps = 1.0, "min", (10.0, 20.0, 30.0, 60.0, 120.0, 180.0)
    elif horizon_min <= MIN_PER_DAY:
        divisor, unit, steps = MIN_PER_H, "h", (2.0, 3.0, 6.0)
    else:
        divisor, unit, steps = MIN_PER_DAY, "days", (0.25, 0.5, 1.0, 2.0, 7.0)
    least = horizon_min / divisor / _MAX_TICK_STEPS[width]
    fitting = [step for step in steps if step >= least]
    # beyond a few weeks, whole weeks
    return divisor, unit, fitting[0] if fitting else steps[-1] * float(np.ceil(least / steps[-1]))


def show_clock(axes: Axes, start_min: float, horizon_min: float, width: Width) -> None:
    """Clock times on an axis of time, at whole multiples of its ticks; beyond a day with the number of the day."""
    from matplotlib.ticker import FixedFormatter, FixedLocator

    divisor, _, tick = time_axis(horizon_min, width)
    step_min = divisor * tick
    t_min = np.arange(-start_min % step_min, horizon_min + 1e-6, step_min)
    days, minutes = np.divmod(start_min + t_min, MIN_PER_DAY)
    clock = [f"{int(minute // 60):02d}:{int(minute % 60):02d}" for minute in minutes]
    if horizon_min > MIN_PER_DAY:
        clock = [f"{text}\nday {int(day) + 1}" for day, text in zip(days, clock, strict=True)]
    axes.xaxis.set_major_locator(FixedLocator((t_min / divisor).tolist()))
    axes.xaxis.set_major_formatter(FixedFormatter(clock))
    axes.set_xlabel("Time of day")


def every(tick: float) -> Locator:
    """Ticks at multiples of a distance."""
    from matplotlib.ticker import MultipleLocator

    return MultipleLocator(tick)
