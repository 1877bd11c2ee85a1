"""One figure per situation, ready for print: glucose above, insulin below."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from glucoloop.metrics import LOWEST_GLUCOSE_MG_DL
from glucoloop.papers.meal_aware.experiments import ComparisonRuns, ControllerRuns
from glucoloop.papers.meal_aware.situations import CONTROLLERS, HORIZON_MIN, MEAL, NAMES, OURS, NamedSituation
from glucoloop.report import _style
from glucoloop.report._style import DASHES, FONT_PT, GREY, OKABE_ITO, Width

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from glucoloop.bounds import OptimalDoses

_ORDER: Final = (OURS, *(name for name in CONTROLLERS if name != OURS))
COLOURS: Final = dict(zip(_ORDER, OKABE_ITO, strict=False))
"""Colour of each controller in all figures."""
_LINES: Final = dict(zip(_ORDER, DASHES, strict=False))
_BAND: Final = (5.0, 50.0, 95.0)
_OPACITY: Final = 0.28
_LINES_MM: Final = 112.0
_BANDS_MM: Final = 92.0
_MEAL_MIN: Final = 50.0
_AROUND_MG_DL: Final = 1.5
_AROUND_MU_MIN: Final = 2.0


def draw(study: ComparisonRuns, *, width: Width = "double") -> dict[str, Figure]:
    """One figure for each situation that was run, by its name.

    Where each controller has one run, glucose and insulin of all controllers are drawn over each other, with those of
    the best possible doses. Where a controller has many runs it has a column of its own, with the median and a band
    from 5 to 95 % of the runs at each moment. Glucose is free of noise, insulin is as delivered.

    Parameters
    ----------
    study : Study
    width : {"single", "double"}
        Width of a printed column: 88 or 180 mm.

    Raises
    ------
    ValueError
        For an unknown width.
    """
    return {
        situation.name: _bands(study.loops[situation.name], width)
        if situation.runs != "one"
        else _lines(study.loops[situation.name], study.bounds.get(situation.name), width)
        for situation in study.situations
    }


def caption(situation: NamedSituation) -> str:
    """Caption of a figure."""
    if situation.runs == "one":
        best = ", and the best doses that there are" if situation.bounded else ""
        return f"Glucose and delivered insulin of one run of each controller{best}. 50 g of carbohydrate at 50 min."
    of = "people" if situation.runs == "people" else "seeds"
    return (
        f"Median over the {of}, and a band from 5 to 95 % of them at each moment, of glucose free of noise and of "
        "delivered insulin. 50 g of carbohydrate at 50 min."
    )


def _lines(loops: Mapping[str, ControllerRuns], bound: OptimalDoses | None, width: Width) -> Figure:
    figure = _style.new_figure(width, _LINES_MM, None)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1.0])
    entries: dict[str, Artist] = {}
    for name, own in loops.items():
        look: dict[str, Any] = {"color": COLOURS[name], "linestyle": _LINES[name]}
        look |= {"linewidth": 1.6 if name == OURS else 1.1, "zorder": 4 if name == OURS else 3}
        entries[NAMES[name]] = above.plot(own.t_min, own.glucose_mg_dl[:, 0], **look)[0]
        below.step(*_held(own, own.insulin_mU_min[:, 0]), where="post", **look)
    if bound is not None:
        look = {"color": "black", "linewidth": 0.8, "zorder": 2}
        entries["best doses that there are"] = above.plot(bound.fine_t_min, bound.glucose_mg_dl, **look)[0]
        t_min = np.append(bound.t_min, bound.fine_t_min[-1])
        below.step(t_min, np.append(bound.insulin_mU_min, bound.insulin_mU_min[-1]), where="post", **look)
    _dress(above, below, next(iter(loops.values())).setpoint_mg_dl, entries, width)
    figure.align_ylabels([above, below])
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _bands(loops: Mapping[str, ControllerRuns], width: Width) -> Figure:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    across = len(loops) if width == "double" else 2
    down = -(-len(loops) // across)
    figure = _style.new_figure(width, _BANDS_MM * down, None)
    panels = figure.subplots(
        2 * down,
        across,
        squeeze=False,
        sharex=True,
        sharey="row" if down == 1 else False,
        height_ratios=[1.6, 1.0] * down,
    )
    glucose, insulin = _range(loops)
    entries: dict[str, Artist] = {}
    for place, (name, own) in enumerate(loops.items()):
        row, column = 2 * (place // across), place % across
        above, below = panels[row, column], panels[row + 1, column]
        low, middle, high = np.percentile(own.glucose_mg_dl, _BAND, axis=1)
        look: dict[str, Any] = {"color": COLOURS[name], "alpha": _OPACITY, "linewidth": 0.0, "zorder": 2}
        above.fill_between(own.t_min, low, high, **look)
        above.plot(own.t_min, middle, color=COLOURS[name], linewidth=1.1, zorder=3)
        low, middle, high = np.percentile(own.insulin_mU_min, _BAND, axis=1)
        below.fill_between(*_held(own, low), _held(own, high)[1], step="post", **look)
        below.step(*_held(own, middle), where="post", color=COLOURS[name], linewidth=1.1, zorder=3)
        above.set_title(NAMES[name], fontsize=FONT_PT, fontweight="bold", loc="left")
        above.set_ylim(*glucose)
        below.set_ylim(*insulin)
        _dress(above, below, own.setpoint_mg_dl, entries, width, first=column == 0, columns=across)
    for place in range(len(loops), down * across):
        for panel in panels[2 * (place // across) : 2 * (place // across) + 2, place % across]:
            panel.set_visible(False)
    entries = {
        "median": Line2D([], [], color=GREY, linewidth=1.1),
        "5 to 95 %": Patch(facecolor=GREY, alpha=_OPACITY, linewidth=0.0),
        **entries,
    }
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _held(loops: ControllerRuns, insulin_mU_min: Any) -> tuple[Any, Any]:
    """Rates and their times, the last one held until the end."""
    return np.append(loops.insulin_t_min, loops.t_min[-1]), np.append(insulin_mU_min, insulin_mU_min[-1])


def _range(loops: Mapping[str, ControllerRuns]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ranges of glucose and insulin that all columns share."""
    glucose = np.concatenate([np.percentile(own.glucose_mg_dl, (5.0, 95.0), axis=1).ravel() for own in loops.values()])
    insulin = np.concatenate([np.percentile(own.insulin_mU_min, (5.0, 95.0), axis=1).ravel() for own in loops.values()])
    return (
        (float(glucose.min()) - _AROUND_MG_DL, float(glucose.max()) + _AROUND_MG_DL),
        (max(-1.0, float(insulin.min()) - _AROUND_MU_MIN), float(insulin.max()) + _AROUND_MU_MIN),
    )


def _dress(
    above: Axes,
    below: Axes,
    setpoint_mg_dl: float,
    entries: dict[str, Artist],
    width: Width,
    *,
    first: bool = True,
    columns: int = 1,
) -> None:
    """Draw frame, setpoint, bound and meal of a pair of panels."""
    entries.setdefault(
        f"setpoint {setpoint_mg_dl:g} mg/dl", above.axhline(setpoint_mg_dl, color=GREY, linewidth=0.7, zorder=1)
    )
    low, high = above.get_ylim()
    if low <= LOWEST_GLUCOSE_MG_DL:
        line = above.axhline(LOWEST_GLUCOSE_MG_DL, color="black", linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        entries.setdefault(f"lowest allowed {LOWEST_GLUCOSE_MG_DL:g} mg/dl", line)
        above.set_ylim(low, high)
    meal = [axes.axvline(_MEAL_MIN, color=GREY, linewidth=0.7, linestyle=":", zorder=1) for axes in (above, below)]
    entries.setdefault(f"meal, {MEAL.split('@')[0].replace('g', ' g')}", meal[0])
    for axes in (above, below):
        _style.dress(axes)
        axes.set_xlim(0.0, HORIZON_MIN)
        tick = _style.time_axis(HORIZON_MIN, width)[2] if columns == 1 else 200.0
        axes.xaxis.set_major_locator(_style.every(tick))
    below.set_xlabel("Time (min)")
    if first:
        above.set_ylabel("Glucose (mg/dl)")
        below.set_ylabel("Insulin (mU/min)")
