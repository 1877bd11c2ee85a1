"""Figure of the sum of squared errors over a grid of tunings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.control.settings import MPCTuning
from glucoloop.refusal import Refusal
from glucoloop.report import _style
from glucoloop.report._style import FONT_PT, Width
from glucoloop.report._surface_layout import Cell, SurfaceLayout, layout, texts
from glucoloop.tuning.surface import TuningSurface, tuning_text

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
_PANELS_PER_ROW: Final = {"single": 2, "double": 4}
_ROW_MM: Final = 42.0
_AROUND_MM: Final = 40.0
_MOST_TICKS: Final = 8
_DARK: Final = 0.45  # a ground of less luminance than this has white letters
_LEAST: Final = 1e-12  # a logarithm is taken
# The legend's words, hatching, and a ground where the cell has no number.
_HATCHES: Final[dict[str, tuple[str, str, str | None]]] = {
    "breaks": ("breaks a constraint", "xxxxx", None),
    "oscillates": ("oscillates", "/////", None),
    "not finite": ("glucose left the finite numbers", "+++++", "0.75"),
    "refused": ("no controller can be designed", ".....", "0.75"),
    "impossible": ("p < m, no such tuning", "", "0.88"),
    "not tried": ("not tried", "", "0.97"),
}


def plot_surface(
    surface: TuningSurface,
    *,
    printed: MPCTuning | None = None,
    called: str = "printed",
    title: str | None = None,
    width: Width = "double",
) -> Figure:
    """Draw the sum of squared errors of each tuning, its colour on a logarithmic scale.

    Tunings that break the constraints or oscillate are hatched; the best of the others has a star and the printed one a
    diamond. Two of the parameters that vary span the axes, and each combination of the others has a panel. Cells
    without a number are grey, and the legend gives the reason.

    Parameters
    ----------
    surface : TuningSurface
    printed : MPCTuning, optional
        The paper's tuning; if it is not a point of the surface, only the legend mentions it.
    called : str
        Name of that tuning in the legend, such as "usual" for a patient that is not the paper's.
    title : str, optional
    width : {"single", "double"}
        Width of a printed column: 88 or 180 mm.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        For more panels than can be seen, no finite result, or an unknown width.
    """
    places = layout(surface)
    combinations = places.combinations()
    if not np.isfinite(surface.sse).any():
        raise Refusal("the surface has no finite sum of squared errors to show")
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
        rows_of_cells = places.rows(combinations[number])
        image = _draw_cells(axes, surface, rows_of_cells)
        _draw_marks(axes, surface, rows_of_cells, printed, called, entries)
        _style.dress(axes)
        _label(axes, places, combinations[number])
        if number + columns >= len(combinations):
            # beside each other there is no room for more than the symbol
            axes.set_xlabel(_NAMES[places.x] if columns == 1 else _SYMBOLS[places.x], fontsize=FONT_PT)
            axes.tick_params(labelbottom=True)
        if number % columns == 0:
            axes.set_ylabel(_NAMES[places.y], fontsize=FONT_PT)
    if printed is not None and printed not in surface.tunings:
        entries[f"{called} {tuning_text(printed)}, beside the grid"] = _mark_of("D", 5.0)
    _add_bar(figure, image, grid)
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def cell_colours(surface: TuningSurface) -> list[tuple[str, str]]:
    """Background and text colour of each point on a page, on the scale of the figure."""
    from matplotlib import colormaps

    logarithm = np.log(np.maximum(surface.sse, _LEAST))
    finite = logarithm[np.isfinite(logarithm)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    shares = (np.nan_to_num(logarithm, nan=high, posinf=high) - low) / max(high - low, 1e-9)
    grounds = colormaps["viridis_r"](shares)[:, :3]
    luminance = grounds @ np.array([0.2126, 0.7152, 0.0722])
    return [
        (f"rgb({', '.join(f'{255 * part:.0f}' for part in ground)})", "#fff" if light < _DARK else "#000")
        for ground, light in zip(grounds, luminance, strict=True)
    ]


def _add_bar(figure: Figure, image: Any, grid: npt.NDArray[Any]) -> None:
    from matplotlib.ticker import LogLocator, NullLocator

    bar = figure.colorbar(image, ax=grid.ravel().tolist(), pad=0.02, aspect=30)
    bar.set_label("Sum of squared errors (mg/dl)²", fontsize=FONT_PT)
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.tick_params(labelsize=FONT_PT, width=0.6, length=2.5)
    bar.outline.set_linewidth(0.6)


def _draw_cells(axes: Axes, surface: TuningSurface, rows: Sequence[Sequence[Cell]]) -> Any:
    from matplotlib.colors import LogNorm

    sums = [[np.nan if cell.point is None else surface.sse[cell.point] for cell in row] for row in rows]
    finite = surface.sse[np.isfinite(surface.sse)]
    low, high = max(float(finite.min()), _LEAST), max(float(finite.max()), _LEAST)
    cells = np.ma.masked_invalid(np.maximum(np.array(sums, float), _LEAST))
    return axes.pcolormesh(cells, cmap="viridis_r", norm=LogNorm(low, max(high, 1.01 * low)), rasterized=False)


def _states(surface: TuningSurface, cell: Cell) -> str:
    """Text of a cell in addition to its number; empty where the number is enough."""
    if cell.point is None:
        return cell.kind
    if not np.isfinite(surface.sse[cell.point]):
        return "not finite"
    if not surface.feasible[cell.point]:
        return "breaks"
    return "oscillates" if surface.oscillates[cell.point] else ""


def _draw_marks(
    axes: Axes,
    surface: TuningSurface,
    rows: Sequence[Sequence[Cell]],
    printed: MPCTuning | None,
    called: str,
    entries: dict[str, Artist],
) -> None:
    from matplotlib.patches import Patch

    placed = [(x, y, cell) for y, row in enumerate(rows) for x, cell in enumerate(row)]
    for state, (label, hatch, face) in _HATCHES.items():
        chosen = [(x, y) for x, y, cell in placed if _states(surface, cell) == state]
        if chosen:
            _fill(axes, chosen, hatch, face)
            shown = Patch(facecolor=face or "0.75", edgecolor="black", hatch=hatch, linewidth=0.0)
            entries.setdefault(label, shown)
    marks: list[tuple[str, int, str, float]] = []
    if surface.acceptable.any():
        best = surface.best_index()
        marks.append((f"best {tuning_text(surface.tunings[best])}", best, "*", 9.0))
    if printed is not None and printed in surface.tunings:
        marks.append((f"{called} {tuning_text(printed)}", surface.index(printed), "D", 5.0))
    for label, point, marker, size in marks:
        mark = _mark_of(marker, size)
        for x, y, cell in placed:
            if cell.point == point:
                axes.plot(x + 0.5, y + 0.5, **_mark_style(marker, size), zorder=4)
        entries.setdefault(label, mark)


def _mark_style(marker: str, size: float) -> dict[str, Any]:
    return {
        "linestyle": "none",
        "marker": marker,
        "markersize": size,
        "markerfacecolor": "white",
        "markeredgecolor": "black",
        "markeredgewidth": 0.8,
    }


def _mark_of(marker: str, size: float) -> Artist:
    """Marker as it appears in the legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **_mark_style(marker, size))


def _fill(axes: Axes, places: Sequence[tuple[int, int]], hatch: str, face: str | None) -> None:
    """Hatch cells as one shape; cells without a number of their own get a background."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path
    from matplotlib.transforms import Bbox, BboxTransformTo

    cells = [
        Path.unit_rectangle().transformed(BboxTransformTo(Bbox.from_bounds(column, row, 1.0, 1.0)))
        for column, row in places
    ]
    axes.add_patch(
        PathPatch(
            Path.make_compound_path(*cells),
            facecolor=face or "none",
            edgecolor="black",
            hatch=hatch,
            linewidth=0.0,
            zorder=3,
        )
    )


def _label(axes: Axes, places: SurfaceLayout, panel: Sequence[float]) -> None:
    for levels, set_ticks in (
        (places.levels[places.x], axes.set_xticks),
        (places.levels[places.y], axes.set_yticks),
    ):
        at = np.arange(0, len(levels), -(-len(levels) // _MOST_TICKS))
        set_ticks(at + 0.5, [f"{levels[place]:g}" for place in at])
    if panel:
        axes.set_title(texts(places.panels, _SYMBOLS, panel), fontsize=FONT_PT)
