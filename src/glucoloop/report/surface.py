"""The sum of squared errors over a grid of tunings, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.control.tuning import MPCTuning
from glucoloop.report import _style
from glucoloop.report._style import FONT_PT, Width
from glucoloop.trials.tuning.surface import TuningSurface, tuning_text

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The first of these that vary become the axes; the others, panels.
_NAMES: Final = {
    "prediction_horizon": "Prediction horizon p (samples)",
    "reference_filter": "Reference filter $\\varphi_r$",
    "move_horizon": "Move horizon m",
    "move_weight": "Move weight $\\Gamma_u$",
    "output_weight": "Output weight $\\Gamma_y$",
}
_SYMBOLS: Final = {
    "prediction_horizon": "p",
    "reference_filter": "$\\varphi_r$",
    "move_horizon": "m",
    "move_weight": "$\\Gamma_u$",
    "output_weight": "$\\Gamma_y$",
}
_MOST_PANELS: Final = 12
_PANELS_PER_ROW: Final = {"single": 2, "double": 4}
_ROW_MM: Final = 42.0
_AROUND_MM: Final = 40.0
_MOST_TICKS: Final = 8


@dataclass(frozen=True)
class _Layout:
    """Which parameter stands where."""

    x: str
    y: str
    panels: tuple[str, ...]
    values: dict[str, npt.NDArray[Any]]
    """(points,) of each parameter."""

    def levels(self, name: str) -> npt.NDArray[Any]:
        return np.unique(self.values[name])

    def combinations(self) -> list[tuple[Any, ...]]:
        """What distinguishes the panels; one empty combination for a single panel."""
        return sorted(set(zip(*(self.values[name].tolist() for name in self.panels), strict=True))) or [()]

    def points_of(self, combination: tuple[Any, ...]) -> npt.NDArray[np.intp]:
        """The points of a panel."""
        inside = np.ones(self.values[self.x].size, bool)
        for name, value in zip(self.panels, combination, strict=True):
            inside &= self.values[name] == value
        return np.flatnonzero(inside)

    def place(self, name: str, points: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
        """Where points stand on an axis: values are evenly spaced, whatever they are."""
        return np.asarray(np.searchsorted(self.levels(name), self.values[name][points]), np.intp)


def plot_surface(
    surface: TuningSurface,
    *,
    printed: MPCTuning | None = None,
    title: str | None = None,
    width: Width = "double",
) -> Figure:
    """Draw the sum of squared errors of each tuning, its colour on a logarithmic scale.

    Tunings that break the constraints or oscillate are hatched, the best of the others is starred, and so is the
    printed one marked. Two of the parameters that vary make the axes, and the others a panel for each combination.

    Parameters
    ----------
    surface : TuningSurface
    printed : MPCTuning, optional
        The paper's tuning; left out where it is not a point of the surface.
    title : str, optional
    width : {"single", "double"}
        Of a printed column: 88 or 180 mm.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        For more panels than can be seen, no finite result, or an unknown width.
    """
    layout = _layout(surface)
    combinations = layout.combinations()
    if len(combinations) > _MOST_PANELS:
        raise ValueError(
            f"the surface would need {len(combinations)} panels, at most {_MOST_PANELS} can be seen; "
            f"give fewer values of {' and '.join(layout.panels)}"
        )
    if not (np.isfinite(surface.sse) & (surface.sse > 0.0)).any():
        raise ValueError("the surface has no finite sum of squared errors to show")
    columns = min(_PANELS_PER_ROW.get(width, 1), len(combinations))
    rows = -(-len(combinations) // columns)
    figure = _style.new_figure(width, rows * _ROW_MM + _AROUND_MM, title)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    entries: dict[str, Artist] = {}
    image = None
    for number, axes in enumerate(grid.flat):
        if number >= len(combinations):
            axes.set_visible(False)
            continue
        shown = layout.points_of(combinations[number])
        image = _draw_cells(axes, surface, layout, shown)
        _draw_marks(axes, surface, layout, shown, printed, entries)
        _style.dress(axes)
        _label(axes, layout, combinations[number])
        if number + columns >= len(combinations):
            # beside each other there is no room for more than the symbol
            axes.set_xlabel(_NAMES[layout.x] if columns == 1 else _SYMBOLS[layout.x], fontsize=FONT_PT)
            axes.tick_params(labelbottom=True)
        if number % columns == 0:
            axes.set_ylabel(_NAMES[layout.y], fontsize=FONT_PT)
    _add_bar(figure, image, grid)
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _add_bar(figure: Figure, image: Any, grid: npt.NDArray[Any]) -> None:
    from matplotlib.ticker import LogLocator, NullLocator

    bar = figure.colorbar(image, ax=grid.ravel().tolist(), pad=0.02, aspect=30)
    bar.set_label("Sum of squared errors (mg/dl)²", fontsize=FONT_PT)
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.tick_params(labelsize=FONT_PT, width=0.6, length=2.5)
    bar.outline.set_linewidth(0.6)


def _layout(surface: TuningSurface) -> _Layout:
    columns = surface.columns()
    values = {name: columns[name] for name in _NAMES if name in columns}
    varying = [name for name in values if np.unique(values[name]).size > 1]
    others = [name for name in values if name not in varying]
    x, y, *_ = [*varying, *others]
    return _Layout(x=x, y=y, panels=tuple(varying[2:]), values=values)


def _draw_cells(axes: Axes, surface: TuningSurface, layout: _Layout, shown: npt.NDArray[np.intp]) -> Any:
    from matplotlib.colors import LogNorm

    finite = surface.sse[np.isfinite(surface.sse) & (surface.sse > 0.0)]
    cells = np.full((layout.levels(layout.y).size, layout.levels(layout.x).size), np.nan)
    cells[layout.place(layout.y, shown), layout.place(layout.x, shown)] = surface.sse[shown]
    low, high = float(finite.min()), float(finite.max())
    return axes.pcolormesh(
        np.ma.masked_invalid(cells), cmap="viridis_r", norm=LogNorm(low, max(high, 1.01 * low)), rasterized=False
    )


def _draw_marks(
    axes: Axes,
    surface: TuningSurface,
    layout: _Layout,
    shown: npt.NDArray[np.intp],
    printed: MPCTuning | None,
    entries: dict[str, Artist],
) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    x, y = layout.place(layout.x, shown), layout.place(layout.y, shown)
    for label, hatch, chosen in (
        ("breaks a constraint", "xxxxx", ~surface.feasible[shown]),
        ("oscillates", "/////", surface.oscillates[shown] & surface.feasible[shown]),
    ):
        if chosen.any():
            _hatch(axes, x[chosen], y[chosen], hatch)
            entries.setdefault(label, Patch(facecolor="0.75", edgecolor="black", hatch=hatch, linewidth=0.0))
    marks: list[tuple[str, int, str, float]] = []
    if surface.acceptable.any():
        best = surface.best_index()
        marks.append((f"best {tuning_text(surface.tunings[best])}", best, "*", 9.0))
    if printed is not None and printed in surface.tunings:
        marks.append((f"printed {tuning_text(printed)}", surface.index(printed), "D", 5.0))
    for label, point, marker, size in marks:
        style: dict[str, Any] = {
            "linestyle": "none",
            "marker": marker,
            "markersize": size,
            "markerfacecolor": "white",
            "markeredgecolor": "black",
            "markeredgewidth": 0.8,
        }
        here = shown == point
        if here.any():
            axes.plot(x[here] + 0.5, y[here] + 0.5, **style, zorder=4)
        entries.setdefault(label, Line2D([], [], **style))


def _hatch(axes: Axes, x: npt.NDArray[np.intp], y: npt.NDArray[np.intp], hatch: str) -> None:
    """Hatch cells, all as one shape."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path
    from matplotlib.transforms import Bbox

    cells = [
        Path.unit_rectangle().transformed(_to(Bbox.from_bounds(column, row, 1.0, 1.0)))
        for column, row in zip(x.tolist(), y.tolist(), strict=True)
    ]
    axes.add_patch(
        PathPatch(
            Path.make_compound_path(*cells), facecolor="none", edgecolor="black", hatch=hatch, linewidth=0.0, zorder=3
        )
    )


def _to(box: Any) -> Any:
    from matplotlib.transforms import BboxTransformTo

    return BboxTransformTo(box)


def _label(axes: Axes, layout: _Layout, panel: Sequence[Any]) -> None:
    for levels, set_ticks in (
        (layout.levels(layout.x), axes.set_xticks),
        (layout.levels(layout.y), axes.set_yticks),
    ):
        every = -(-levels.size // _MOST_TICKS)
        at = np.arange(0, levels.size, every)
        set_ticks(at + 0.5, [f"{levels[place]:g}" for place in at])
    texts = [f"{_SYMBOLS[name]} = {value:g}" for name, value in zip(layout.panels, panel, strict=True)]
    if texts:
        axes.set_title(", ".join(texts), fontsize=FONT_PT)
