"""Figure of the closed loop, ready for print: glucose above, insulin below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from glucoloop.arguments import ArgumentTypeError
from glucoloop.cohorts.people_run import PeopleRun
from glucoloop.metrics import LOWEST_GLUCOSE_MG_DL
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.report import _style
from glucoloop.report._runs import Floats, PlottedRun, labelled_runs, limits_passed, values_in_words
from glucoloop.report._style import FONT_PT, GREY, Width
from glucoloop.report.people_figure import plot_people
from glucoloop.simulation import Trace
from glucoloop.units import mmol_l_from_mg_dl, u_h_from_mu_min

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEIGHTS_MM: Final = {"single": 95.0, "double": 115.0}
_PANEL_SHARE: Final = 0.8  # of the figure's width; the rest holds labels
_MOST_NAMED: Final = 12
"""Boluses whose size is written; more would hide one another."""
_LINE_MM: Final = 3.0  # a line of text, and about two of its characters


def plot(
    traces: Trace | PeopleRun | Mapping[str, Trace] | Mapping[str, PeopleRun],
    *,
    title: str | None = None,
    width: Width = "double",
    mmol: bool = False,
    units_per_hour: bool = False,
    limits: DoseLimits = PARKER_1999_LIMITS,
    lowest_glucose_mg_dl: float = LOWEST_GLUCOSE_MG_DL,
) -> Figure:
    """Draw one run, or several of the same scenario over each other.

    Above, glucose free of noise, readings as dots where they differ from it, the setpoint, the bound on glucose, and
    each meal with its carbohydrate. Below, the delivered rate as steps, boluses as stems on an axis in U, the basal
    rate, and the pump's limits where they come into view.

    Parameters
    ----------
    traces : Trace, PeopleRun, or mapping of str to one of these
        Traces of one person each, or of many, drawn as bands of 90 % and of 50 % of them about their median. Labels
        go to the legend.
    title : str, optional
    width : {"single", "double"}
        Width of a printed column: 88 or 180 mm.
    mmol : bool
        Whether a second axis shows glucose in mmol/l.
    units_per_hour : bool
        Whether a second axis shows insulin in U/h, as pumps do that give it under the skin. Where boluses were given,
        the second axis is theirs, and the legend tells the basal rate in U/h.
    limits : DoseLimits
        Limits of the pump.
    lowest_glucose_mg_dl : float
        The bound on glucose.

    Returns
    -------
    matplotlib.figure.Figure
        Figure outside pyplot's state; write it with ``savefig`` to SVG, PDF or PNG (300 dots per inch).

    Raises
    ------
    ValueError
        If there is no trace, one is of many people, the meals differ, or the width is unknown.
    """
    named = traces if isinstance(traces, Mapping) else {"glucose": traces}
    of_people = {str(label): run for label, run in named.items() if isinstance(run, PeopleRun)}
    of_one = {str(label): run for label, run in named.items() if isinstance(run, Trace)}
    strangers = [type(run).__name__ for run in named.values() if not isinstance(run, Trace | PeopleRun)]
    if strangers or (of_people and of_one):
        raise ArgumentTypeError(
            f"traces holds {strangers[0]}, which cannot be drawn; give what simulate or simulate_people returned"
            if strangers
            else "traces holds runs of one person and of many; draw them in two figures"
        )
    if of_people:
        return plot_people(
            of_people,
            title=title,
            width=width,
            mmol=mmol,
            units_per_hour=units_per_hour,
            lowest_glucose_mg_dl=lowest_glucose_mg_dl,
        )
    runs = labelled_runs(of_one)
    figure = _style.new_figure(width, _HEIGHTS_MM.get(width, 0.0), title)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1.0])
    divisor, unit, tick = _style.time_axis(max(run.horizon_min for run in runs), width)
    entries: dict[str, Artist] = {}
    _draw_glucose(above, runs, divisor, lowest_glucose_mg_dl, entries)
    _mark_meals(above, runs[0].meals, divisor, panel_mm=_PANEL_SHARE * _style.WIDTHS_MM[width])
    _draw_insulin(below, runs, divisor, limits, entries)
    for axes in (above, below):
        _style.dress(axes)
    below.set_xlabel(f"Time ({unit})")
    below.xaxis.set_major_locator(_style.every(tick))
    figure.align_ylabels([above, below])
    if mmol:
        _style.add_axis(above, mmol_l_from_mg_dl(1.0), "Glucose (mmol/l)")
    if any(run.boluses for run in runs):
        _draw_boluses(below, runs, divisor, entries)
    elif units_per_hour:
        _style.add_axis(below, u_h_from_mu_min(1.0), "Insulin (U/h)")
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _dot() -> Artist:
    """Legend entry for the readings of any run."""
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="none", marker=".", markersize=4, markeredgewidth=0, color=GREY)


def _draw_glucose(
    axes: Axes, runs: Sequence[PlottedRun], divisor: float, lowest_mg_dl: float, entries: dict[str, Artist]
) -> None:
    setpoints = list(dict.fromkeys(run.setpoint_mg_dl for run in runs))
    for setpoint in setpoints:
        line = axes.axhline(setpoint, color=GREY, linewidth=0.7, zorder=1)
    bound = axes.axhline(lowest_mg_dl, color="black", linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
    for index, run in enumerate(runs):
        style = _style.line_style(index)
        axes.plot(
            run.reading_t_min / divisor,
            run.reading_mg_dl,
            linestyle="none",
            marker=".",
            markersize=2.5,
            markeredgewidth=0,
            color=style["color"],
            alpha=0.55,
            zorder=2,
        )
        glucose = axes.plot(run.fine_t_min / divisor, run.shown_glucose_mg_dl, **style, zorder=3)[0]
        entries[run.label] = glucose
    if any(run.reading_t_min.size for run in runs):
        entries["sensor readings"] = _dot()
    entries[f"setpoint {values_in_words(setpoints, 'mg/dl')}"] = line
    entries[f"lowest allowed {lowest_mg_dl:g} mg/dl"] = bound
    axes.annotate(
        f"{lowest_mg_dl:g} mg/dl",
        (0.01, lowest_mg_dl),
        xycoords=axes.get_yaxis_transform(),
        xytext=(0, -2),
        textcoords="offset points",
        va="top",
        fontsize=FONT_PT,
    )
    for limit in limits_passed(runs):
        area = axes.axhspan(-1e6, limit, facecolor=GREY, alpha=0.18, linewidth=0, zorder=0)
        entries[f"model not valid, below {limit:.1f} mg/dl"] = area
    axes.set_ylabel("Glucose (mg/dl)")
    shown = [np.array([*setpoints, lowest_mg_dl])]
    shown += [values for run in runs for values in (run.shown_glucose_mg_dl, run.reading_mg_dl)]
    low, high = _extent(shown)
    axes.set_ylim(low - 0.12 * (high - low), high + 0.05 * (high - low))


def _mark_meals(axes: Axes, meals: Sequence[tuple[float, float]], divisor: float, panel_mm: float) -> None:
    """Mark each meal at the upper edge with its carbohydrate above, rotated where meals are close."""
    if not meals:
        return
    t_min = np.array([t for t, _ in meals])
    upper_edge = axes.get_xaxis_transform()
    axes.plot(
        t_min / divisor,
        np.ones_like(t_min),
        linestyle="none",
        marker="v",
        markersize=4,
        color="black",
        transform=upper_edge,
        clip_on=False,
    )
    horizon_min = axes.dataLim.x1 * divisor
    apart_mm = np.diff(t_min).min(initial=np.inf) / horizon_min * panel_mm
    if apart_mm < _LINE_MM:
        return
    texts = [f"{carbs_g:.4g} g" for _, carbs_g in meals]
    upright = apart_mm < _LINE_MM / 2.0 * (max(map(len, texts)) + 1)
    for t, text in zip(t_min, texts, strict=True):
        axes.annotate(
            text,
            (t / divisor, 1.0),
            xycoords=upper_edge,
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            va="bottom",
            rotation=90 if upright else 0,
            fontsize=FONT_PT,
        )


def _draw_insulin(
    axes: Axes, runs: Sequence[PlottedRun], divisor: float, limits: DoseLimits, entries: dict[str, Artist]
) -> None:
    basal = list(dict.fromkeys(run.basal_insulin_mU_min for run in runs))
    for rate in basal:
        line = axes.axhline(rate, color=GREY, linewidth=0.8, linestyle=(0, (1, 1.5)), zorder=1)
    entries[f"basal {values_in_words(basal, 'mU/min')}"] = line
    for index, run in enumerate(runs):
        axes.step(run.t_min / divisor, run.insulin_mU_min, where="post", **_style.line_style(index), zorder=3)
    low, high = _extent([np.array([0.0, *basal]), *(run.insulin_mU_min for run in runs)])
    low, high = low - 0.05 * (high - low), high + 0.08 * (high - low)
    in_view = [bound for bound in (float(limits.min_mU_min), float(limits.max_mU_min)) if low <= bound <= high]
    for bound in in_view:
        at_limit = axes.axhline(bound, color="black", linewidth=0.6, linestyle=(0, (6, 2, 1, 2)), zorder=1)
    if in_view:
        noun = "pump limit" if len(in_view) == 1 else "pump limits"
        entries[f"{noun} {values_in_words(in_view, 'mU/min')}"] = at_limit
    axes.set_ylabel("Insulin (mU/min)")
    axes.set_ylim(low, high)
    axes.set_xlim(0.0, max(run.horizon_min for run in runs) / divisor)


def _draw_boluses(axes: Axes, runs: Sequence[PlottedRun], divisor: float, entries: dict[str, Artist]) -> None:
    """A stem for each bolus, on an axis of its own in units of insulin, with its size above where there is room."""
    from matplotlib.lines import Line2D

    right = axes.twinx()
    for index, run in enumerate(runs):
        colour = _style.line_style(index)["color"]
        t = np.array([t for t, _ in run.boluses]) / divisor
        size = np.array([size for _, size in run.boluses])
        right.vlines(t, 0.0, size, color=colour, linewidth=1.2, zorder=4)
        right.plot(t, size, linestyle="none", marker="o", markersize=3.5, color=colour, zorder=4)
        if len(runs) == 1 and t.size <= _MOST_NAMED:
            for place, units in zip(t, size, strict=True):
                right.annotate(
                    f"{units:.3g} U",
                    (place, units),
                    xytext=(0, 3),
                    textcoords="offset points",
                    ha="center",
                    va="bottom",
                    fontsize=FONT_PT,
                )
    largest = max(size for run in runs for _, size in run.boluses)
    low, high = axes.get_ylim()
    # zero of both axes at one height
    right.set_ylim(1.35 * largest * low / high, 1.35 * largest)
    right.set_ylabel("Bolus (U)", fontsize=FONT_PT)
    right.tick_params(labelsize=FONT_PT, width=0.6, length=2.5)
    right.spines["top"].set_visible(False)
    right.spines["right"].set_linewidth(0.6)
    entries["bolus"] = Line2D([], [], color=GREY, linewidth=1.2, marker="o", markersize=3.5)


def _extent(shown: Sequence[Floats]) -> tuple[float, float]:
    values = np.concatenate(shown)
    values = values[np.isfinite(values)]
    low, high = float(values.min()), float(values.max())
    return low, max(high, low + 1.0)
