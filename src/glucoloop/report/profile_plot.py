"""Percentiles of glucose over the day, as plots of a page and as rows of a table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from glucoloop.display_units import other_number
from glucoloop.metrics.readings.profile import PERCENTILES, DayProfile
from glucoloop.report.charts import GLUCOSE, Panel, Plot
from glucoloop.report.record_goals import Goals
from glucoloop.report.record_groups import Reported
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

AXIS_MG_DL: Final = (40.0, 300.0)
LARGEST_MG_DL: Final = 400.0
"""Ends of the axis of glucose where no curve needs more, and its largest end."""


def highest_shown(profile: DayProfile) -> float:
    """Upper end of the axis of glucose: 300 mg/dl, or more where the upper curve needs it, up to 400 mg/dl."""
    highest = float(np.nan_to_num(profile.percentiles_mg_dl[95]).max())
    return min(LARGEST_MG_DL, max(AXIS_MG_DL[1], 1.05 * highest))


def profile_plot(label: str, profile: DayProfile, goals: Goals) -> Plot:
    """Plot of percentiles over the day."""
    top = highest_shown(profile)
    panel = _panel(top, goals)
    of = {percentage: np.clip(values, AXIS_MG_DL[0], top) for percentage, values in profile.percentiles_mg_dl.items()}
    panel.area(profile.t_min, of[5], of[95], 0, "5 to 95 %")
    panel.area(profile.t_min, of[25], of[75], 0, "25 to 75 %")
    panel.line(profile.t_min, of[50], 0, name="median")
    return Plot(f"Glucose over the day, {label}", MIN_PER_DAY, [panel])


def medians_plot(reported: Sequence[Reported], goals: Goals) -> Plot:
    """Medians of several records or groups over the day in one plot; of two also the middle halves."""
    top = max(highest_shown(one.profile) for one in reported)
    panel = _panel(top, goals)
    for place, one in enumerate(reported):
        of = {at: np.clip(values, AXIS_MG_DL[0], top) for at, values in one.profile.percentiles_mg_dl.items()}
        if len(reported) == 2:
            panel.area(one.profile.t_min, of[25], of[75], place, f"{one.label}, 25 to 75 %")
        panel.line(one.profile.t_min, of[50], place, name=f"{one.label}, median")
    return Plot("Medians over the day side by side", MIN_PER_DAY, [panel])


def _panel(top: float, goals: Goals) -> Panel:
    panel = Panel(GLUCOSE, (AXIS_MG_DL[0], top), height=330, band=goals.target_mg_dl)
    panel.rule(goals.target_mg_dl, 0, "target")
    panel.rule([54.0, 250.0], 1, "54 and 250 mg/dl")
    return panel


def percentile_rows(profile: DayProfile) -> Iterator[list[Any]]:
    """Rows of the percentiles every hour."""
    for place in range(0, profile.t_min.size - 1, int(MIN_PER_H) // 15):
        row: list[Any] = [_clock(profile.t_min[place])]
        for percentage in PERCENTILES:
            value = float(profile.percentiles_mg_dl[percentage][place])
            text = f"{value:.0f}" if math.isfinite(value) else "none"
            row.append((text, other_number(text, value, "mg/dl"), "mg/dl"))
        yield row


def _clock(t_min: float) -> str:
    return f"{int(t_min) // 60 % 24:02d}:{int(t_min) % 60:02d}"
