"""Figure of the effect of the worst sensor errors, ready for print."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from glucoloop.control import Status
from glucoloop.printable import glucose_text
from glucoloop.report import _style
from glucoloop.report._style import FONT_PT, GREY, OKABE_ITO
from glucoloop.studies.adversary.outcome import SearchOutcome

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROW_MM: Final = 52.0
_SAID: Final = {
    Status.READING_REJECTED: ("reading rejected", OKABE_ITO[4]),
    Status.FALLBACK_BASAL: ("fallback to the basal rate", OKABE_ITO[2]),
    Status.FALLBACK_REDUCED: ("fallback to a part of it", OKABE_ITO[5]),
    Status.SUSPENDED: ("insulin suspended", OKABE_ITO[3]),
    Status.DOSE_LIMITED: ("dose limited", "0.6"),
}
"""Label and colour of each status of a guard."""


def plot_adversary(outcomes: Sequence[SearchOutcome], *, title: str | None = None) -> Figure:
    """Draw the worst loop of every controller, one row for each, one column for each size of the errors.

    Above: the person's glucose, the sensor's readings, and lines at 54 and 70 mg/dl. Below: insulin as delivered, and
    behind it, in colour, the status of the guard.

    Parameters
    ----------
    outcomes : sequence of SearchOutcome
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure
        Figure outside pyplot's state; write it with ``savefig``.
    """
    controllers = list(dict.fromkeys(of.cell.controller for of in outcomes))
    errors = list(dict.fromkeys(of.cell.error_pct for of in outcomes))
    figure = _style.new_figure("double", 18.0 + _ROW_MM * len(controllers), title)
    panels = figure.subplots(
        2 * len(controllers), len(errors), squeeze=False, sharex=True, height_ratios=[2.2, 1.0] * len(controllers)
    )
    highest = max(float(np.max(of.worst.lane.glucose_mg_dl)) for of in outcomes)
    highest = max(highest, *(float(np.nanmax(of.worst.lane.reading_mg_dl)) for of in outcomes))
    most = max(float(np.max(of.worst.lane.insulin_mU_min)) for of in outcomes)
    entries: dict[str, Artist] = {}
    for of in outcomes:
        row, column = 2 * controllers.index(of.cell.controller), errors.index(of.cell.error_pct)
        glucose, insulin = panels[row][column], panels[row + 1][column]
        entries |= _draw_glucose(glucose, of)
        entries |= _draw_insulin(insulin, of)
        glucose.set_ylim(0.0, 1.05 * highest)
        insulin.set_ylim(0.0, 1.05 * most)
        lowest = glucose_text(of.worst.lowest_mg_dl, 0)
        glucose.set_title(
            f"{of.cell.name}\n{of.worst.below_54_min:.0f} min below 54, lowest {lowest} mg/dl",
            fontsize=FONT_PT,
            loc="left",
        )
        if column == 0:
            glucose.set_ylabel("Glucose\n(mg/dl)")
            insulin.set_ylabel("Insulin\n(mU/min)")
    horizon = float(outcomes[0].worst.lane.t_min[-1])
    divisor, unit, _ = _style.time_axis(horizon, "double")
    _, _, tick = _style.time_axis(horizon, "single")
    for axes in panels.ravel():
        _style.dress(axes)
        axes.set_xlim(0.0, horizon)
        axes.xaxis.set_major_locator(_style.every(tick * divisor))
        axes.xaxis.set_major_formatter(lambda value, place: f"{value / divisor:g}")
    for axes in panels[-1]:
        axes.set_xlabel(f"Time ({unit})")
    _style.add_legend(figure, list(entries.values()), list(entries), "double")
    return figure


def _draw_glucose(axes: Axes, of: SearchOutcome) -> dict[str, Artist]:
    lane = of.worst.lane
    for bound in (54.0, 70.0):
        axes.axhline(bound, color=GREY, linewidth=0.6, linestyle=(0, (4, 3)), zorder=1)
    axes.fill_between(
        lane.t_min,
        lane.glucose_mg_dl,
        54.0,
        where=lane.glucose_mg_dl < 54.0,
        color=OKABE_ITO[1],
        alpha=0.35,
        linewidth=0.0,
    )
    return {
        "glucose": axes.plot(lane.t_min, lane.glucose_mg_dl, color="black", linewidth=1.1)[0],
        "reading": axes.plot(
            lane.t_min[:-1], lane.reading_mg_dl, color=OKABE_ITO[1], marker=".", markersize=1.6, linewidth=0.4
        )[0],
    }


def _draw_insulin(axes: Axes, of: SearchOutcome) -> dict[str, Artist]:
    lane = of.worst.lane
    entries: dict[str, Artist] = {}
    for status, (said, colour) in _SAID.items():
        for sample in np.flatnonzero(lane.status == int(status)):
            entries[said] = axes.axvspan(
                lane.t_min[sample], lane.t_min[sample + 1], color=colour, alpha=0.45, linewidth=0.0
            )
    entries["insulin"] = axes.stairs(lane.insulin_mU_min, lane.t_min, color=OKABE_ITO[0], linewidth=1.1, baseline=None)
    return entries
