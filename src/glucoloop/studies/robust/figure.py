"""Figure of a search for a tuning, ready for print: the trade-off, and the chosen tuning on other subjects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.report import _style
from glucoloop.report._style import FONT_PT, GREY
from glucoloop.storage.findings import Findings
from glucoloop.studies.robust.search import AS_IT_WAS, CHOSEN, OBJECTIVES

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from glucoloop.studies.robust import Search

_HEIGHT_MM: Final = 94.0
_SHOWN: Final = 0.9
"""Share of the tunings within the bounds that each axis must show; a few are far away."""
_ROOM: Final = 0.06
_MARKERS: Final = ("D", "s", "^", "v", "P", "X")


def plot_robust(asked: Search, found: Findings, *, title: str | None = None) -> Figure:
    """Draw the two objectives of every tuning with the front, and undershoot on subjects that were not searched on."""
    figure = _style.new_figure("double", _HEIGHT_MM, title)
    trade, people, noise = figure.subplots(1, 3, gridspec_kw={"width_ratios": [1.5, 1.0, 1.0]})
    styles = _styles([CHOSEN, AS_IT_WAS, *found.plain["beside"]])
    entries = _draw_trade(trade, asked, found, styles)
    check = found.tables["check.parquet"]
    _draw_check(people, check.filter(group="people"), "people", styles)
    _draw_check(noise, check.filter(group="noise"), "seeds", styles)
    for axes in (people, noise):
        axes.set_xlim(0.0, 1.04 * check["undershoot_mg_dl"].to_numpy().max())
    noise.tick_params(labelleft=False)
    noise.set_ylabel("")
    _style.dress(trade, people, noise)
    _style.add_legend(figure, entries, "double")
    return figure


def _styles(labels: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Colour, dashes and marker of each controller, of which the first one is chosen."""
    found = {}
    for index, label in enumerate(labels):
        marker = "*" if index == 0 else _MARKERS[(index - 1) % len(_MARKERS)]
        found[label] = {**_style.line_style(index), "marker": marker, "markersize": 10.0 if index == 0 else 5.0}
    return found


def _draw_trade(
    axes: Axes, asked: Search, found: Findings, styles: Mapping[str, Mapping[str, Any]]
) -> dict[str, Artist]:
    """Draw the tunings, the front, the bounds and the other controllers; returns the entries of the legend."""
    from matplotlib.lines import Line2D

    x, y = (OBJECTIVES[name] for name in asked.objectives)
    plain = found.plain
    candidates = found.tables["candidates.csv"].filter(pl.all_horizontal(pl.col(x.name, y.name).is_finite()))
    out, within = candidates.filter(~pl.col("keeps_the_bounds")), candidates.filter("keeps_the_bounds")
    front = candidates.filter("on_the_front").sort(x.name, y.name)
    entries: dict[str, Artist] = {}

    def draw(label: str, points: pl.DataFrame, **style: Any) -> None:
        if len(points):
            entries[label] = axes.plot(points[x.name], points[y.name], **{"linestyle": "none", **style})[0]

    draw("exceeds a bound", out, marker="x", markersize=2.8, markeredgewidth=0.5, color="0.72", zorder=1)
    draw("tuning", within, marker="o", markersize=2.4, markeredgewidth=0.0, color="0.5", zorder=2)
    steps = {"drawstyle": "steps-post", "linestyle": "-", "linewidth": 0.8, "markerfacecolor": "white"}
    draw("front", front, **steps, color="black", marker="o", markersize=3.2, markeredgewidth=0.7, zorder=3)
    marks = {CHOSEN: plain["chosen"]["scores"]}
    if plain["as_it_was"] is not None:
        marks[AS_IT_WAS] = plain["as_it_was"]["scores"]
    places = {
        label: np.array([scores[x.name], scores[y.name]], float)
        for label, scores in {**marks, **plain["beside"]}.items()
    }
    for label, place in places.items():
        style = {**styles[label], "markeredgecolor": "black", "markeredgewidth": 0.6}
        axes.plot(*place, **{**style, "linestyle": "none"}, zorder=4)
        entries[label] = Line2D([], [], **style)
    lines = dict(zip(asked.objectives, (axes.axvline, axes.axhline), strict=True))
    for bound in plain["bounds"]:
        if bound["objective"] in lines and bound["at_most"] is not None:
            line = lines[bound["objective"]]
            entries["bound"] = line(bound["at_most"], color=GREY, linewidth=0.8, linestyle=(0, (4, 2)), zorder=0)
    axes.set_xlabel(x.head, fontsize=FONT_PT)
    axes.set_ylabel(y.head, fontsize=FONT_PT)
    readable = np.array([*front.select(x.name, y.name).to_numpy(), *places.values()])
    cloud = (within if len(within) else candidates).select(x.name, y.name).to_numpy()
    _zoom(axes, candidates.select(x.name, y.name).to_numpy(), readable, cloud)
    return entries


def _zoom(
    axes: Axes, points: npt.NDArray[np.float64], readable: npt.NDArray[np.float64], cloud: npt.NDArray[np.float64]
) -> None:
    """Limit the axes to points that must be readable, and to as many of a cloud of others as leave them readable."""
    shown = np.array([*readable, np.quantile(cloud, _SHOWN, axis=0), cloud.min(axis=0)])
    low, high = np.nanmin(shown, axis=0), np.nanmax(shown, axis=0)
    room = np.where(high > low, high - low, 1.0) * _ROOM
    axes.set_xlim(low[0] - room[0], high[0] + room[0])
    axes.set_ylim(low[1] - room[1], high[1] + room[1])
    beyond = int((points > high + room).any(axis=1).sum())
    if beyond:
        inside: dict[str, Any] = {"xytext": (-2.0, -2.0), "xycoords": "axes fraction", "ha": "right", "va": "top"}
        _style.write(axes, f"{beyond} beyond", (1.0, 1.0), **inside, color=GREY)


def _draw_check(axes: Axes, check: pl.DataFrame, what: str, styles: Mapping[str, Mapping[str, Any]]) -> None:
    """Draw the share of the subjects with at most each undershoot, for each controller."""
    for (label,), subjects in check.group_by("controller", maintain_order=True):
        undershoot = np.sort(subjects["undershoot_mg_dl"].to_numpy())
        share = 100.0 * np.arange(1, undershoot.size + 1) / undershoot.size
        style = {key: styles[str(label)][key] for key in ("color", "linestyle", "linewidth")}
        axes.step(np.append(0.0, undershoot), np.append(0.0, share), where="post", **style)
    axes.axhline(95.0, color=GREY, linewidth=0.6, linestyle=(0, (1, 1.5)), zorder=0)
    axes.set_ylim(0.0, 100.0)
    axes.set_title(f"{undershoot.size} {what} not seen", fontsize=FONT_PT, loc="left")
    axes.set_xlabel("Undershoot (mg/dl)", fontsize=FONT_PT)
    axes.set_ylabel("Share with at most so much (%)", fontsize=FONT_PT)
