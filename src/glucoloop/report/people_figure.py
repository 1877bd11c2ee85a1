"""Figure of many people: bands of their glucose and insulin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from glucoloop.cohorts.people_run import PeopleRun
from glucoloop.metrics import LOWEST_GLUCOSE_MG_DL
from glucoloop.refusal import Refusal
from glucoloop.report import _style
from glucoloop.report._runs import Floats
from glucoloop.report._style import GREY, Width
from glucoloop.units import mmol_l_from_mg_dl, u_h_from_mu_min

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PERCENTILES: Final = (5.0, 25.0, 50.0, 75.0, 95.0)
_HEIGHTS_MM: Final = {"single": 95.0, "double": 115.0}


def bands(values: Floats) -> Floats:
    """Percentiles 5, 25, 50, 75 and 95 over people, ``(5, samples)``; people without a finite course are left out.

    Parameters
    ----------
    values : (samples, people) array

    Raises
    ------
    ValueError
        If no person is left.
    """
    finite = values[:, np.isfinite(values).all(axis=0)]
    if finite.shape[1] == 0:
        raise Refusal("no person has a finite course to show; draw people who have a basal rate")
    percentiles: Floats = np.percentile(finite, PERCENTILES, axis=1)
    return percentiles


def plot_people(
    runs: Mapping[str, PeopleRun],
    *,
    title: str | None = None,
    width: Width = "double",
    mmol: bool = False,
    units_per_hour: bool = False,
    lowest_glucose_mg_dl: float = LOWEST_GLUCOSE_MG_DL,
) -> Figure:
    """Draw the medians of people's glucose and insulin in bands of half of them and of nine in ten.

    Parameters
    ----------
    runs : mapping of str to PeopleRun
        Runs by label for the legend. Only the meals of the first run are marked.
    title, width, mmol, units_per_hour, lowest_glucose_mg_dl
        As for `plot`.

    Raises
    ------
    ValueError
        If there is no run, no person has a finite course, or the width is unknown.
    """
    if not runs:
        raise Refusal("there is no run to show; give at least one")
    figure = _style.new_figure(width, _HEIGHTS_MM.get(width, 0.0), title)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1.0])
    first = next(iter(runs.values()))
    horizon_min = max(float(run.t_min[-1]) for run in runs.values())
    divisor, unit, tick = _style.time_axis(horizon_min, width)
    entries: dict[str, Artist] = {}
    for index, (label, run) in enumerate(runs.items()):
        t = np.asarray(run.t_min, float) / divisor
        insulin = np.concatenate([run.insulin_mU_min, run.insulin_mU_min[-1:]])
        _draw_bands(above, t, bands(np.asarray(run.glucose_mg_dl, float)), index, label, entries)
        _draw_bands(below, t, bands(insulin.astype(float)), index, label, {}, step="post")
    entries[f"setpoint {first.setpoint_mg_dl:.4g} mg/dl"] = above.axhline(
        first.setpoint_mg_dl, color=GREY, linewidth=0.7
    )
    entries[f"lowest allowed {lowest_glucose_mg_dl:g} mg/dl"] = above.axhline(
        lowest_glucose_mg_dl, color="black", linewidth=0.8, linestyle=(0, (4, 3))
    )
    eaten = [meal.t_min / divisor for meal in first.scenario.meals]
    above.plot(
        eaten,
        np.ones(len(eaten)),
        linestyle="none",
        marker="v",
        markersize=4,
        color="black",
        transform=above.get_xaxis_transform(),
        clip_on=False,
    )
    above.set_ylabel("Glucose (mg/dl)")
    below.set_ylabel("Insulin (mU/min)")
    below.set_xlabel(f"Time ({unit})")
    below.set_xlim(0.0, horizon_min / divisor)
    below.xaxis.set_major_locator(_style.every(tick))
    for axes in (above, below):
        _style.dress(axes)
    figure.align_ylabels([above, below])
    if mmol:
        _style.add_axis(above, mmol_l_from_mg_dl(1.0), "Glucose (mmol/l)")
    if units_per_hour:
        _style.add_axis(below, u_h_from_mu_min(1.0), "Insulin (U/h)")
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _draw_bands(
    axes: Axes,
    t: Floats,
    of: Floats,
    index: int,
    label: str,
    entries: dict[str, Artist],
    step: Literal["post"] | None = None,
) -> None:
    style = _style.line_style(index)
    for low, high, alpha, share in ((0, 4, 0.15, 90), (1, 3, 0.3, 50)):
        band = axes.fill_between(t, of[low], of[high], step=step, color=style["color"], alpha=alpha, linewidth=0)
        entries[f"{label}: {share} % of people"] = band
    median = axes.plot(t, of[2], **style, drawstyle="steps-post" if step else "default")[0]
    entries[f"{label}: median"] = median
