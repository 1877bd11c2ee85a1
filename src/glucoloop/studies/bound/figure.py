"""Figure of the best doses and the glucose under them, ready for print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from glucoloop.bounds import OptimalDoses
from glucoloop.meals import Meal
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.report import _style
from glucoloop.report._style import Width
from glucoloop.report.charts import extent

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure


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
    horizon_min = max(float(plan.fine_t_min[-1]) for plan in plans.values())
    figure, above, below, divisor = _style.loop_panels(horizon_min, title, width, ratio=1.4)
    first = next(iter(plans.values()))
    entries: dict[str, Artist] = {}
    setpoint = above.axhline(first.setpoint_mg_dl, **_style.SETPOINT, zorder=1)
    basal = below.axhline(first.basal_insulin_mU_min, **_style.BASAL)
    for index, (label, plan) in enumerate(plans.items()):
        style = _style.line_style(index)
        entries[label] = above.plot(plan.fine_t_min / divisor, plan.glucose_mg_dl, **style, zorder=3)[0]
        t_min = np.append(plan.t_min, plan.fine_t_min[-1])
        doses = np.append(plan.insulin_mU_min, plan.insulin_mU_min[-1])
        below.step(t_min / divisor, doses, where="post", **style, zorder=3)
    entries[f"setpoint {first.setpoint_mg_dl:.4g} mg/dl"] = setpoint
    entries[f"basal {first.basal_insulin_mU_min:.4g} mU/min"] = basal
    _style.mark_meals(above, [(meal.t_min, meal.carbs_g) for meal in meals], horizon_min, width)
    low, high = extent(*(plan.glucose_mg_dl for plan in plans.values()))
    above.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    low, high = extent([0.0], *(plan.insulin_mU_min for plan in plans.values()))
    low, high = low - 0.06 * (high - low), high + 0.06 * (high - low)
    for limit in (float(limits.min_mU_min), float(limits.max_mU_min)):
        if low <= limit <= high:
            entries["pump limits"] = below.axhline(limit, **_style.PUMP_LIMIT)
    below.set_ylim(low, high)
    _style.add_legend(figure, entries, width)
    return figure
