"""Figure of the best doses and the glucose under them, ready for print."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from glucoloop.bounds import OptimalDoses
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
    meals: Sequence[Meal] = (),
    *,
    title: str | None = None,
    width: Width = "double",
    limits: DoseLimits = PARKER_1999_LIMITS,
) -> Figure:
    """Draw plans over each other: glucose with the setpoint and the meals above, the doses as steps below.

    A plan ends where it is followed to. The pump's limits are drawn where they come into view.
    """
    if not plans:
        raise Refusal("there is no bound to show; give at least one plan")
    figure = _style.new_figure(width, _PANELS_MM.get(width, 0.0), title)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.4, 1.0])
    horizon_min = max(float(plan.fine_t_min[-1]) for plan in plans.values())
    divisor, unit, tick = _style.time_axis(horizon_min, width)
    first = next(iter(plans.values()))
    entries: dict[str, Artist] = {}
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
    above.set_ylim(*_extent([plan.glucose_mg_dl for plan in plans.values()], 0.08))
    low, high = _extent([np.zeros(1), *(plan.insulin_mU_min for plan in plans.values())], 0.06)
    for limit in (float(limits.min_mU_min), float(limits.max_mU_min)):
        if low <= limit <= high:
            line = below.axhline(limit, color="black", linewidth=0.6, linestyle=(0, (6, 2, 1, 2)), zorder=1)
            entries["pump limits"] = line
    below.set_ylim(low, high)
    below.set_xlim(0.0, horizon_min / divisor)
    below.xaxis.set_major_locator(_style.every(tick))
    above.set_ylabel("Glucose (mg/dl)")
    below.set_ylabel("Insulin (mU/min)")
    below.set_xlabel(f"Time ({unit})")
    for axes in (above, below):
        _style.dress(axes)
    figure.align_ylabels([above, below])
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _extent(shown: Iterable[npt.NDArray[np.float64]], margin: float) -> tuple[float, float]:
    values = np.concatenate(list(shown))
    low, high = float(values.min()), float(values.max())
    room = margin * max(high - low, 0.1)
    return low - room, high + room


def _mark_meals(axes: Axes, meals: Sequence[Meal], divisor: float) -> None:
    """Mark each meal at the upper edge with its carbohydrate above."""
    for meal in meals:
        place, upper_edge = (meal.t_min / divisor, 1.0), axes.get_xaxis_transform()
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
