"""Figure of the performance of estimators of unknown meals, ready for print."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from glucoloop.report import _style
from glucoloop.report._style import FONT_PT, GREY, Width
from glucoloop.studies.detection.result import Curve, DetectionResult, EstimatorResult
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_UNTOLD_PCT: Final = 50.0
"""Largest percentage of undetected meals at which a median delay is drawn."""
_FEWEST: Final = 0.1
"""Share of the meals that must be detected for quantiles to be meaningful."""
_TRUTH: Final = "true rate"


def plot_detection(result: DetectionResult, *, title: str | None = None, width: Width = "double") -> Figure:
    """Draw delay against false alarms, the error of the size over time, and a day.

    The first panel has a point for each threshold, the one that was asked for filled: the median delay of the meals
    that are detected, against the rises above the threshold on days without a meal. The second one shows what is
    expected of a meal's size less the true size, by the time since its beginning, of the meals detected by then:
    median, and from the 10 % to the 90 % quantile. The others show the first day of the first person.

    Parameters
    ----------
    result : DetectionResult
    title : str, optional
    width : {"single", "double"}
        Width of a printed column: 88 or 180 mm.

    Returns
    -------
    matplotlib.figure.Figure
        Figure outside pyplot's state; write it with ``savefig``.

    Raises
    ------
    ValueError
        For an unknown width.
    """
    figure = _style.new_figure(width, 130.0 if width == "double" else 210.0, title)
    rows = [["curve", "size"], ["eating", "eating"], ["emptying", "emptying"]]
    if width == "single":
        rows = [["curve"], ["size"], ["eating"], ["emptying"]]
    ratios = [1.5, 1.0, 1.0] if width == "double" else [1.4, 1.2, 1.0, 1.0]
    panels = figure.subplot_mosaic(rows, height_ratios=ratios)  # type: ignore[arg-type, unused-ignore]
    entries: dict[str, Artist] = {}
    for index, of in enumerate(result.estimators):
        entries[of.estimator] = _draw_curve(panels["curve"], of, index)
        _draw_size(panels["size"], of, index)
        _draw_day(panels["eating"], panels["emptying"], of, index)
    first = result.estimators[0]
    entries[_TRUTH] = panels["emptying"].plot(
        _hours(first), first.example.emptying_mg_min, color="black", linewidth=0.9, zorder=1
    )[0]
    _label(panels, result, width)
    for axes in panels.values():
        _style.dress(axes)
    figure.align_ylabels([panels["eating"], panels["emptying"]])
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _draw_curve(axes: Axes, of: EstimatorResult, index: int) -> Artist:
    style = _style.line_style(index)
    curve, told = of.curve, _drawn(of.curve)
    alarms, delay = curve.false_alarms_fasting_per_day[told], curve.delay_median_min[told]
    drawn = axes.plot(alarms, delay, marker="o", markersize=2.2, **style)[0]
    here = told & (curve.threshold == of.threshold)
    if here.any():
        place = float(curve.false_alarms_fasting_per_day[here][0]), float(curve.delay_median_min[here][0])
        axes.plot(*place, marker="o", markersize=5.0, color=style["color"], linestyle="none", zorder=4)
        axes.annotate(
            f"{of.threshold:g}",
            place,
            xytext=(4 + 2.2 * FONT_PT * index, 4),  # beside one another where two estimators are at one place
            textcoords="offset points",
            fontsize=FONT_PT,
            color=style["color"],
        )
    return drawn


def _drawn(curve: Curve) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether each threshold detects enough meals for a meaningful median."""
    told = np.isfinite(curve.delay_median_min)
    return told & (curve.missed_pct + curve.already_pct < _MOST_UNTOLD_PCT)


def _draw_size(axes: Axes, of: EstimatorResult, index: int) -> None:
    style, error = _style.line_style(index), of.size_error
    few = error.meals < _FEWEST * error.meals.max(initial=1)
    low, middle, high = np.where(few, np.nan, error.error_g)
    axes.fill_between(error.after_min, low, high, color=style["color"], alpha=0.15, linewidth=0.0)
    for edge in (low, high):
        axes.plot(error.after_min, edge, color=style["color"], linewidth=0.4, linestyle=style["linestyle"])
    axes.plot(error.after_min, middle, **style)


def _hours(of: EstimatorResult) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.asarray(of.example.t_min / MIN_PER_H)


def _draw_day(eating: Axes, emptying: Axes, of: EstimatorResult, index: int) -> None:
    style = {**_style.line_style(index), "linewidth": 0.9}
    eating.plot(_hours(of), of.example.eating, **style)
    emptying.plot(_hours(of), of.example.estimated_emptying_mg_min, **style)


def _label(panels: dict[str, Axes], result: DetectionResult, width: Width) -> None:
    first = result.estimators[0]
    curve, size, eating, emptying = (panels[name] for name in ("curve", "size", "eating", "emptying"))
    # Few false alarms are worth as much room as many, and there may be none.
    curve.set_xscale("symlog", linthresh=0.1)
    curve.set_xlim(left=-0.01)
    curve.set_ylim(bottom=0.0)
    curve.xaxis.set_major_formatter(lambda value, place: f"{value:g}")
    curve.set_xlabel("False alarms per fasting day")
    curve.set_ylabel("Median delay (min)")
    size.axhline(0.0, color=GREY, linewidth=0.6, zorder=1)
    size.set_xlim(0.0, float(first.size_error.after_min[-1]))
    size.xaxis.set_major_locator(_style.every(60.0))
    size.set_xlabel("Time since the meal began (min)")
    size.set_ylabel("Error of the size (g)")
    eating.axhline(first.threshold, color=GREY, linewidth=0.6, linestyle=(0, (4, 3)), zorder=1)
    eating.set_ylim(-0.03, 1.03)
    eating.set_ylabel("Probability\nof a meal")
    eating.tick_params(labelbottom=False)
    emptying.set_ylabel("Emptying of\nthe stomach\n(mg/min)")
    emptying.set_xlabel("Time (h)")
    for axes in (eating, emptying):
        axes.set_xlim(0.0, MIN_PER_DAY / MIN_PER_H)
        axes.xaxis.set_major_locator(_style.every(2.0 if width == "double" else 6.0))
