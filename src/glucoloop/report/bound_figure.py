"""Figure of the best doses and the glucose under them, ready for print; with noise, also of the hedged doses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from glucoloop.bounds import HedgedDoses, OptimalDoses
from glucoloop.meals import Meal
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.report import _style
from glucoloop.report._style import FONT_PT, GREY, Width

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS_MM: Final = {"single": 95.0, "double": 115.0}


def plot_bound(
    plans: Mapping[str, OptimalDoses],
    hedged: Mapping[str, HedgedDoses] | None = None,
    *,
    meals: Sequence[Meal] = (),
    title: str | None = None,
    width: Width = "double",
    limits: DoseLimits = PARKER_1999_LIMITS,
) -> Figure:
    """Draw plans over each other.

    Above, glucose under each plan and the setpoint, with a mark for each meal; below, the doses as steps, the basal
    rate, and the pump's limits where they come into view. Plans for two worlds are drawn for the meal as it is, up to
    where they are followed.

    Parameters
    ----------
    plans : mapping of str to OptimalDoses
        Plans of one situation, by the knowledge of the meals.
    hedged : mapping of str to HedgedDoses, optional
        Hedged doses, by the fact that is known late.
    meals : sequence of Meal
    title : str, optional
    width : {"single", "double"}
        Width of a printed column: 88 or 180 mm.
    limits : DoseLimits
        Limits of the pump.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If there is nothing to draw, or the width is unknown.
    """
    drawn = {**plans, **{label: of.meal for label, of in (hedged or {}).items()}}
    if not drawn:
        raise Refusal("there is no bound to show; give at least one plan")
    figure = _style.new_figure(width, _PANELS_MM.get(width, 0.0), title)
    above, below = figure.subplots(2, 1, height_ratios=[1.4, 1.0])
    entries: dict[str, Artist] = {}
    _draw_plans(above, below, drawn, meals, limits, width, entries)
    for axes in (above, below):
        _style.dress(axes)
    figure.align_ylabels([above, below])
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _draw_plans(
    above: Axes,
    below: Axes,
    plans: Mapping[str, OptimalDoses],
    meals: Sequence[Meal],
    limits: DoseLimits,
    width: Width,
    entries: dict[str, Artist],
) -> None:
    first = next(iter(plans.values()))
    horizon_min = max(float(plan.fine_t_min[-1]) for plan in plans.values())
    divisor, unit, tick = _style.time_axis(horizon_min, width)
    setpoint = above.axhline(first.setpoint_mg_dl, color=GREY, linewidth=0.7, zorder=1)
    basal = below.axhline(first.basal_insulin_mU_min, color=GREY, linewidth=0.8, linestyle=(0, (1, 1.5)), zorder=1)
    for index, (label, plan) in enumerate(plans.items()):
        style = _style.line_style(index)
        entries[label] = above.plot(plan.fine_t_min / divisor, plan.glucose_mg_dl, **style, zorder=3)[0]
        t_min = np.append(plan.t_min, plan.fine_t_min[-1])
        doses = np.append(plan.insulin_mU_min, plan.insulin_mU_min[-1])
        below.step(t_min / divisor, doses, where="post", **style, zorder=3)
    entries[f"setpoint {first.setpoint_mg_dl:.4g} mg/dl"] = setpoint
    entries[f"basal {first.basal_insulin_mU_min:.4g} mU/min"] = basal
    _mark_meals(above, meals, divisor)
    low, high = _extent(np.concatenate([plan.glucose_mg_dl for plan in plans.values()]), 0.08)
    above.set_ylim(low, high)
    above.set_ylabel("Glucose (mg/dl)")
    low, high = _extent(np.append(np.concatenate([plan.insulin_mU_min for plan in plans.values()]), 0.0), 0.06)
    in_view = [bound for bound in (float(limits.min_mU_min), float(limits.max_mU_min)) if low <= bound <= high]
    for bound in in_view:
        line = below.axhline(bound, color="black", linewidth=0.6, linestyle=(0, (6, 2, 1, 2)), zorder=1)
        entries["pump limits"] = line
    below.set_ylim(low, high)
    below.set_ylabel("Insulin (mU/min)")
    below.set_xlabel(f"Time ({unit})")
    for axes in (above, below):
        axes.set_xlim(0.0, horizon_min / divisor)
        axes.xaxis.set_major_locator(_style.every(tick))
    above.tick_params(labelbottom=False)


def _extent(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]], margin: float) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    room = margin * max(high - low, 0.1)
    return low - room, high + room


def _mark_meals(axes: Axes, meals: Sequence[Meal], divisor: float) -> None:
    """Mark each meal at the upper edge with its carbohydrate above."""
    for meal in meals:
        place = (meal.t_min / divisor, 1.0)
        upper_edge = axes.get_xaxis_transform()
        axes.plot(*place, "v", markersize=4, color="black", transform=upper_edge, clip_on=False)
        axes.annotate(
            f"{meal.carbs_g:.4g} g",
            place,
            xycoords=upper_edge,
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=FONT_PT,
        )
