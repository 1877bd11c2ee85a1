"""Figure of the closed loop, ready for print: glucose above, insulin below, of one person or as bands of many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from glucoloop.arguments import ArgumentTypeError
from glucoloop.metrics import LOWEST_GLUCOSE_MG_DL, TARGET_RANGE_MG_DL
from glucoloop.physiology.exercise import Exercise
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.reporting import _style
from glucoloop.reporting._style import GREY, Width
from glucoloop.reporting.charts import extent
from glucoloop.reporting.labelled_traces import (
    Bout,
    Floats,
    PlottedRun,
    in_view,
    labelled_runs,
    limits_passed,
    values_in_words,
)
from glucoloop.simulation import Trace
from glucoloop.trials.people_run import PeopleRun
from glucoloop.units import MIN_PER_DAY, mmol_l_from_mg_dl, u_h_from_mu_min

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class _Rates(NamedTuple):
    """Unit of the rates of insulin, and its number for each mU/min."""

    factor: float
    unit: str


_PERCENTILES: Final = (5.0, 25.0, 50.0, 75.0, 95.0)
_MAX_NAMED: Final = 12
"""Boluses whose size is written; more would hide one another."""


def plot(
    traces: Trace | PeopleRun | Mapping[str, Trace] | Mapping[str, PeopleRun],
    *,
    title: str | None = None,
    width: Width = "double",
    mmol: bool = False,
    subcutaneous: bool = False,
    start_min: float | None = None,
    limits: DoseLimits = PARKER_1999_LIMITS,
    lowest_glucose_mg_dl: float = LOWEST_GLUCOSE_MG_DL,
) -> Figure:
    """Draw one run, or several of the same scenario over each other.

    Above, glucose free of noise, readings as dots where they differ from it, some of the forecasts as thin lines where
    the trace has them, the setpoint, the bound on glucose, each meal with its carbohydrate, and exercise with its
    intensity. Below, the delivered rate as steps, boluses as stems on an axis in U, with subcutaneous insulin on board
    beside them, glucagon as triangles along the upper edge, the basal rate, and the pump's limits where they come into
    view. By default they are drawn as in Parker et al. (1999).

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
    subcutaneous : bool
        Whether insulin is subcutaneous: rates are then in U/h, as pumps show them, and the range from 70 to 180 mg/dl
        of the consensus is a band, in place of the bound on glucose.
    start_min : float, optional
        Time of day at the start, in minutes after midnight; the axis is then that of the clock. Days of subcutaneous
        insulin begin at midnight if it is not given.
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
    runs = [] if of_people else labelled_runs(of_one)
    all_runs: list[PeopleRun | PlottedRun] = [*of_people.values(), *runs]
    horizon_min = max(float(run.t_min[-1]) for run in all_runs)
    figure, above, below, divisor = _style.loop_panels(horizon_min, title, width, ratio=1.6)
    if start_min is None and subcutaneous and horizon_min > MIN_PER_DAY:
        start_min = 0.0
    if start_min is not None:
        _style.show_clock(below, start_min, horizon_min, width)
    rates = _Rates(u_h_from_mu_min(1.0), "U/h") if subcutaneous else _Rates(1.0, "mU/min")
    below.set_ylabel(f"Insulin ({rates.unit})")
    entries: dict[str, Artist] = {}
    if of_people:
        _draw_people(above, below, of_people, divisor, rates, entries)
        scenario = next(iter(of_people.values())).scenario
        meals = [(meal.t_min, meal.carbs_g) for meal in scenario.meals]
        exercise: Sequence[Bout | Exercise] = scenario.exercise
    else:
        _draw_glucose(above, runs, divisor, entries)
        meals, exercise = runs[0].meals, runs[0].exercise
    levels = TARGET_RANGE_MG_DL if subcutaneous else (lowest_glucose_mg_dl,)
    _draw_levels(above, [float(run.setpoint_mg_dl) for run in all_runs], levels, entries)
    if runs:
        _draw_glucose_limits(above, runs, levels, entries)
        _draw_insulin(below, runs, divisor, limits, rates, entries)
    _style.mark_meals(above, meals, horizon_min, width)
    _style.mark_exercise(above, exercise, horizon_min, width)
    if mmol:
        _style.add_axis(above, mmol_l_from_mg_dl(1.0), "Glucose (mmol/l)")
    if any(run.boluses or (run.insulin_on_board_U > 0.0).any() for run in runs):
        _draw_units(below, runs, divisor, entries)
    if any(run.glucagon for run in runs):
        _draw_glucagon(below, runs, divisor, entries)
    _style.add_legend(figure, entries, width)
    return figure


def _bands(values: Floats) -> Floats:
    """Percentiles ``(5, samples)`` of values ``(samples, people)``; people without a finite course are left out."""
    finite = values[:, np.isfinite(values).all(axis=0)]
    if finite.shape[1] == 0:
        raise Refusal("no person has a finite course to show; draw people who have a basal rate")
    percentiles: Floats = np.percentile(finite, _PERCENTILES, axis=1)
    return percentiles


def _draw_people(
    above: Axes,
    below: Axes,
    runs: Mapping[str, PeopleRun],
    divisor: float,
    rates: _Rates,
    entries: dict[str, Artist],
) -> None:
    """Medians in bands of half of the people and of nine in ten."""
    for index, (label, run) in enumerate(runs.items()):
        insulin = rates.factor * np.concatenate([run.insulin_mU_min, run.insulin_mU_min[-1:]])
        for axes, values, stepwise in ((above, run.glucose_mg_dl, False), (below, insulin, True)):
            low, quarter, median, three_quarters, high = _bands(np.asarray(values, float))
            drawn = _style.draw_bands(
                axes,
                np.asarray(run.t_min, float) / divisor,
                [(low, high, 0.15), (quarter, three_quarters, 0.3)],
                median,
                _style.line_style(index),
                stepwise=stepwise,
            )
            names = [f"{label}: {name}" for name in ("90 % of people", "50 % of people", "median")]
            entries |= dict(zip(names, drawn, strict=True))


def _draw_levels(axes: Axes, setpoints: Sequence[float], levels: Sequence[float], entries: dict[str, Artist]) -> None:
    """Setpoints, and the bound on glucose or the target range."""
    for setpoint in dict.fromkeys(setpoints):
        line = axes.axhline(setpoint, **_style.SETPOINT, zorder=1)
    entries[f"setpoint {values_in_words(setpoints, 'mg/dl')}"] = line
    if len(levels) > 1:
        low, high = levels
        entries[f"{low:g} to {high:g} mg/dl"] = axes.axhspan(low, high, **_style.TARGET_RANGE)
    else:
        entries[f"lowest allowed {levels[0]:g} mg/dl"] = axes.axhline(levels[0], **_style.BOUND, zorder=1)


def _draw_glucose(axes: Axes, runs: Sequence[PlottedRun], divisor: float, entries: dict[str, Artist]) -> None:
    from matplotlib.lines import Line2D

    dot: dict[str, Any] = {"linestyle": "none", "marker": ".", "markeredgewidth": 0}
    for index, run in enumerate(runs):
        style = _style.line_style(index)
        t, readings = run.reading_t_min / divisor, run.reading_mg_dl
        axes.plot(t, readings, **dot, markersize=2.5, color=style["color"], alpha=0.55, zorder=2)
        for times, values in run.forecasts:
            axes.plot(times / divisor, values, **_style.FORECAST, color=style["color"])
        entries[run.label] = axes.plot(run.fine_t_min / divisor, run.shown_glucose_mg_dl, **style, zorder=3)[0]
    if any(run.reading_t_min.size for run in runs):
        entries["sensor readings"] = Line2D([], [], **dot, markersize=4, color=GREY)
    every_min = max(run.forecasts_every_min for run in runs)
    if any(run.forecasts for run in runs):
        words = f"forecasts, every {every_min:g} min" if every_min else "forecast"
        entries[words] = Line2D([], [], **_style.FORECAST, color=GREY)


def _draw_glucose_limits(
    axes: Axes, runs: Sequence[PlottedRun], bounds: Sequence[float], entries: dict[str, Artist]
) -> None:
    """Words at the bound on glucose, and where a model is not valid; the axis has room for both."""
    if len(bounds) == 1:
        at_the_left: Any = {"xycoords": axes.get_yaxis_transform(), "ha": "left", "va": "top"}
        _style.write(axes, f"{bounds[0]:g} mg/dl", (0.01, bounds[0]), down=2, **at_the_left)
    for limit in limits_passed(runs):
        area = axes.axhspan(-1e6, limit, facecolor=GREY, alpha=0.18, linewidth=0, zorder=0)
        entries[f"model not valid, below {limit:.1f} mg/dl"] = area
    levels = [*bounds, *(run.setpoint_mg_dl for run in runs)]
    low, high = extent(
        levels,
        *(part for run in runs for part in (run.shown_glucose_mg_dl, run.reading_mg_dl, *in_view(run.forecasts))),
    )
    axes.set_ylim(low - 0.12 * (high - low), high + 0.05 * (high - low))


def _draw_insulin(
    axes: Axes,
    runs: Sequence[PlottedRun],
    divisor: float,
    limits: DoseLimits,
    rates: _Rates,
    entries: dict[str, Artist],
) -> None:
    basal = [rates.factor * run.basal_insulin_mU_min for run in runs]
    for rate in dict.fromkeys(basal):
        line = axes.axhline(rate, **_style.BASAL)
    entries[f"basal {values_in_words(basal, rates.unit)}"] = line
    delivered = [rates.factor * run.insulin_mU_min for run in runs]
    for index, (run, rates_of_run) in enumerate(zip(runs, delivered, strict=True)):
        axes.step(run.t_min / divisor, rates_of_run, where="post", **_style.line_style(index), zorder=3)
    low, high = extent([0.0, *basal], *delivered)
    low, high = low - 0.05 * (high - low), high + 0.08 * (high - low)
    bounds = (rates.factor * float(bound) for bound in (limits.min_mU_min, limits.max_mU_min))
    in_view = [bound for bound in bounds if low <= bound <= high]
    for bound in in_view:
        at_limit = axes.axhline(bound, **_style.PUMP_LIMIT)
    if in_view:
        noun = "pump limit" if len(in_view) == 1 else "pump limits"
        entries[f"{noun} {values_in_words(in_view, rates.unit)}"] = at_limit
    axes.set_ylim(low, high)


def _draw_units(axes: Axes, runs: Sequence[PlottedRun], divisor: float, entries: dict[str, Artist]) -> None:
    """Stems of boluses, with their sizes where there is room, and insulin on board, on an axis of their own in U."""
    from matplotlib.lines import Line2D

    right = axes.twinx()
    on_board = any(run.insulin_on_board_U.size for run in runs)
    for index, run in enumerate(runs):
        colour = _style.line_style(index)["color"]
        if on_board:
            right.plot(run.t_min[:-1] / divisor, run.insulin_on_board_U, **_style.ON_BOARD, color=colour)
        t = np.array([t for t, _ in run.boluses]) / divisor
        size = np.array([size for _, size in run.boluses])
        right.vlines(t, 0.0, size, color=colour, linewidth=1.2, zorder=4)
        right.plot(t, size, linestyle="none", marker="o", markersize=3.5, color=colour, zorder=4)
        if len(runs) == 1 and t.size <= _MAX_NAMED:
            for place, units in zip(t, size, strict=True):
                _style.write(right, f"{units:.3g} U", (place, units), down=-3)
    largest = max(0.0, *(units for run in runs for units in (*run.insulin_on_board_U, *(of[1] for of in run.boluses))))
    low, high = axes.get_ylim()
    # zero of both axes at one height
    right.set_ylim(1.35 * largest * low / high, 1.35 * largest)
    right.set_ylabel("Bolus, on board (U)" if on_board else "Bolus (U)")
    _style.dress_right(right)
    if any(run.boluses for run in runs):
        entries["bolus"] = Line2D([], [], color=GREY, linewidth=1.2, marker="o", markersize=3.5)
    if on_board:
        entries["insulin on board"] = Line2D([], [], **_style.ON_BOARD, color=GREY)


def _draw_glucagon(axes: Axes, runs: Sequence[PlottedRun], divisor: float, entries: dict[str, Artist]) -> None:
    """A triangle for each dose along the upper edge, in one row for each run, with the sum in the legend."""
    total_ug = [sum(amount for _, amount in run.glucagon) for run in runs]
    for index, run in enumerate(runs):
        [drawn] = axes.plot(
            np.array([t for t, _ in run.glucagon]) / divisor,
            np.full(len(run.glucagon), 0.96 - 0.06 * index),
            transform=axes.get_xaxis_transform(),
            linestyle="none",
            marker="v",
            markersize=3.5,
            markeredgewidth=0,
            color=_style.line_style(index)["color"],
            zorder=4,
        )
    entries[f"glucagon, {' and '.join(f'{total:.0f}' for total in total_ug)} ug in all"] = drawn
