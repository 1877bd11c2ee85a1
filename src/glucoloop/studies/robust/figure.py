"""Figure of a search for a tuning, ready for print: the trade-off, and the chosen tuning on other subjects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal
from glucoloop.report import _style
from glucoloop.report._style import FONT_PT, GREY, Width
from glucoloop.studies.robust.front import Bound
from glucoloop.studies.robust.objectives import OBJECTIVES
from glucoloop.studies.robust.search import AS_IT_WAS, CHOSEN, Candidate, Checked, Judgement, Search

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANEL_MM: Final = 70.0
_AROUND_MM: Final = 24.0
_SHOWN: Final = 0.9
"""Share of the tunings within the bounds that each axis must show; a few are far away."""
_ROOM: Final = 0.06
_MARKERS: Final = ("D", "s", "^", "v", "P", "X")


def plot_robust(
    search: Search,
    candidates: Sequence[Candidate],
    verdict: Judgement,
    bounds: Sequence[Bound],
    references: Mapping[str, Mapping[str, float]],
    checked: Sequence[Checked],
    *,
    title: str | None = None,
    width: Width = "double",
) -> Figure:
    """Draw the two objectives of every tuning with the front, and undershoot on subjects that were not searched on.

    Parameters
    ----------
    search : Search
    candidates : sequence of Candidate
    verdict : Judgement
    bounds : sequence of Bound
        Bounds; those on an objective of the front are drawn.
    references : mapping
        Scores of the reference controllers, by label.
    checked : sequence of Checked
        Results of the check; without any, the front is drawn alone.
    title : str, optional
    width : {"single", "double"}
        Width of a printed column: 88 or 180 mm.

    Returns
    -------
    matplotlib.figure.Figure
        Figure outside pyplot's state.

    Raises
    ------
    ValueError
        For an unknown width, or if no tuning has finite objectives.
    """
    values = np.array([[of.scores[name] for name in search.objectives] for of in candidates]).reshape(-1, 2)
    finite = np.isfinite(values).all(axis=1)
    if not finite.any():
        raise Refusal("no tuning has finite objectives, so there is nothing to draw")
    groups = 3 if checked else 1
    down = groups if width == "single" else 1
    across = groups if down == 1 else 1
    figure = _style.new_figure(width, down * _PANEL_MM + _AROUND_MM, title)
    ratios = {"width_ratios": [1.5, 1.0, 1.0]} if across == 3 else {}
    panels = figure.subplots(down, across, squeeze=False, gridspec_kw=ratios).ravel()
    entries: dict[str, Artist] = {}
    styles = _styles(references)
    _draw_front(panels[0], search, values, finite, verdict, entries)
    _draw_marks(panels[0], search, candidates, values, verdict, references, styles, entries)
    _draw_bounds(panels[0], search, bounds, entries)
    _zoom(panels[0], search, values, finite, verdict, references)
    if checked:
        _draw_checked(panels[1], checked, styles, people=True)
        _draw_checked(panels[2], checked, styles, people=False)
        last = max(np.max(of.undershoot_mg_dl) for of in checked)
        for axes in panels[1:]:
            axes.set_xlim(0.0, 1.04 * last)
        if across == 3:
            panels[2].tick_params(labelleft=False)
            panels[2].set_ylabel("")
    for axes in panels:
        _style.dress(axes)
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _styles(references: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Colour, dashes and marker of each controller."""
    found = {}
    for index, label in enumerate((CHOSEN, AS_IT_WAS, *references)):
        marker = "*" if index == 0 else _MARKERS[(index - 1) % len(_MARKERS)]
        found[label] = {**_style.line_style(index), "marker": marker, "markersize": 10.0 if index == 0 else 5.0}
    return found


def _draw_front(
    axes: Axes,
    search: Search,
    values: npt.NDArray[np.float64],
    finite: npt.NDArray[np.bool_],
    verdict: Judgement,
    entries: dict[str, Artist],
) -> None:
    out, kept = finite & ~verdict.keeps, verdict.keeps
    if out.any():
        entries["exceeds a bound"] = axes.plot(
            *values[out].T, linestyle="none", marker="x", markersize=2.8, markeredgewidth=0.5, color="0.72", zorder=1
        )[0]
    if kept.any():
        entries["tuning"] = axes.plot(
            *values[kept].T, linestyle="none", marker="o", markersize=2.4, markeredgewidth=0.0, color="0.5", zorder=2
        )[0]
        front = values[verdict.front]
        front = front[np.lexsort((front[:, 1], front[:, 0]))]
        entries["front"] = axes.step(
            *front.T,
            where="post",
            color="black",
            linewidth=0.8,
            marker="o",
            markersize=3.2,
            markerfacecolor="white",
            markeredgewidth=0.7,
            zorder=3,
        )[0]
    x, y = (_label(name) for name in search.objectives)
    axes.set_xlabel(x, fontsize=FONT_PT)
    axes.set_ylabel(y, fontsize=FONT_PT)


def _label(name: str) -> str:
    of = OBJECTIVES[name]
    return f"{of.label} ({of.unit})" if of.unit else of.label


def _draw_marks(
    axes: Axes,
    search: Search,
    candidates: Sequence[Candidate],
    values: npt.NDArray[np.float64],
    verdict: Judgement,
    references: Mapping[str, Mapping[str, float]],
    styles: Mapping[str, dict[str, Any]],
    entries: dict[str, Artist],
) -> None:
    from matplotlib.lines import Line2D

    places = {CHOSEN: values[verdict.chosen]}
    if candidates and dict(candidates[0].tuning) == search.start:
        places[AS_IT_WAS] = values[0]
    places |= {label: np.array([of[name] for name in search.objectives]) for label, of in references.items()}
    for label, place in places.items():
        style = styles[label]
        axes.plot(
            *place,
            linestyle="none",
            marker=style["marker"],
            markersize=style["markersize"],
            color=style["color"],
            markeredgecolor="black",
            markeredgewidth=0.6,
            zorder=4,
        )
        entries[label] = Line2D([], [], **style, markeredgecolor="black", markeredgewidth=0.6)


def _draw_bounds(axes: Axes, search: Search, bounds: Sequence[Bound], entries: dict[str, Artist]) -> None:
    for bound in bounds:
        if bound.objective in search.objectives:
            draw = axes.axvline if bound.objective == search.objectives[0] else axes.axhline
            entries["bound"] = draw(bound.most, color=GREY, linewidth=0.8, linestyle=(0, (4, 2)), zorder=0)


def _zoom(
    axes: Axes,
    search: Search,
    values: npt.NDArray[np.float64],
    finite: npt.NDArray[np.bool_],
    verdict: Judgement,
    references: Mapping[str, Mapping[str, float]],
) -> None:
    """Limit the axes to the front and the marks, and to as many other tunings as leave these readable."""
    cloud = values[verdict.keeps] if verdict.keeps.any() else values[finite]
    marked = [*values[verdict.front], values[verdict.chosen]]
    if finite[0]:
        marked.append(values[0])
    marked += [np.array([of[name] for name in search.objectives]) for of in references.values()]
    shown = np.array([*marked, np.quantile(cloud, _SHOWN, axis=0), cloud.min(axis=0)])
    low, high = np.nanmin(shown, axis=0), np.nanmax(shown, axis=0)
    room = np.where(high > low, high - low, 1.0) * _ROOM
    axes.set_xlim(low[0] - room[0], high[0] + room[0])
    axes.set_ylim(low[1] - room[1], high[1] + room[1])
    beyond = int((finite & ((values > high + room).any(axis=1))).sum())
    if beyond:
        axes.annotate(
            f"{beyond} beyond",
            (1.0, 1.0),
            xycoords="axes fraction",
            xytext=(-2.0, -2.0),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=FONT_PT,
            color=GREY,
        )


def _draw_checked(
    axes: Axes, checked: Sequence[Checked], styles: Mapping[str, dict[str, Any]], *, people: bool
) -> None:
    for place, of in enumerate(checked):
        style = {
            key: styles.get(of.label, _style.line_style(place))[key] for key in ("color", "linestyle", "linewidth")
        }
        which = slice(None, of.people) if people else slice(of.people, None)
        undershoot = np.sort(of.undershoot_mg_dl[which])
        share = 100.0 * np.arange(1, undershoot.size + 1) / undershoot.size
        axes.step(np.append(0.0, undershoot), np.append(0.0, share), where="post", **style)
    axes.axhline(95.0, color=GREY, linewidth=0.6, linestyle=(0, (1, 1.5)), zorder=0)
    axes.set_ylim(0.0, 100.0)
    number = checked[0].people if people else checked[0].undershoot_mg_dl.size - checked[0].people
    axes.set_title(f"{number} people not seen" if people else f"{number} seeds not seen", fontsize=FONT_PT, loc="left")
    axes.set_xlabel("Undershoot (mg/dl)", fontsize=FONT_PT)
    axes.set_ylabel("Share with at most so much (%)", fontsize=FONT_PT)
