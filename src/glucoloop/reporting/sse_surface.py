"""Sum of squared errors over a grid of tunings: its places, and its figure.

Two parameters span the axes, and each combination of the others has a panel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glucoloop.control.tuning import MPCTuning, StateTuning
from glucoloop.refusal import Refusal
from glucoloop.reporting import _style
from glucoloop.reporting._style import FONT_PT, Width
from glucoloop.tuning.surface import TuningSurface, tuning_text

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MAX_PANELS: Final = 12
# The first of these that vary become the axes; the others, panels.
_PARAMETERS: Final = ("prediction_horizon", "reference_filter", "move_horizon", "move_weight", "output_weight")
_SYMBOLS: Final = {
    "prediction_horizon": "p",
    "reference_filter": "$\\varphi_r$",
    "move_horizon": "m",
    "move_weight": "$\\Gamma_u$",
    "output_weight": "$\\Gamma_y$",
}
_NAMES: Final = {
    name: f"{name.replace('_', ' ').capitalize()} {symbol}{' (samples)' if name == 'prediction_horizon' else ''}"
    for name, symbol in _SYMBOLS.items()
}
_PANELS_PER_ROW: Final = {"single": 2, "double": 4}
_ROW_MM: Final = 42.0
_AROUND_MM: Final = 40.0
_MAX_TICKS: Final = 8
_DARK: Final = 0.45  # a ground of less luminance than this has white letters
_LEAST: Final = 1e-12  # a logarithm is taken
CELL_WORDS: Final = {
    "breaks": "breaks a constraint",
    "oscillates": "oscillates",
    "not finite": "glucose left the finite numbers",
    "refused": "no controller can be designed",
    "impossible": "p < m, no such tuning",
    "not tried": "not tried",
}
"""Kinds of cells of which there is more to say than a number, in words."""
# Hatching, and a ground where the cell has no number.
_LOOKS: Final[dict[str, tuple[str, str | None]]] = {
    "breaks": ("xxxxx", None),
    "oscillates": ("/////", None),
    "not finite": ("+++++", "0.75"),
    "refused": (".....", "0.75"),
    "impossible": ("", "0.88"),
    "not tried": ("", "0.97"),
}


class Cell(NamedTuple):
    """One place of the grid: a kind of `CELL_WORDS` or ``"kept"``, its point on the surface, or why it was refused."""

    kind: str
    point: int | None = None
    reason: str = ""


@dataclass(frozen=True)
class SurfaceLayout:
    """Parameters of the axes and those that tell panels apart, and the content of every cell."""

    x: str
    y: str
    panels: tuple[str, ...]
    levels: dict[str, list[float]]
    """The values of each parameter, in rising order."""
    cells: dict[tuple[float, ...], list[list[Cell]]]
    """Cells ``[row][column]`` of each panel, by its values of the parameters in `panels`; every place holds a cell."""


def layout(surface: TuningSurface) -> SurfaceLayout:
    """Lay out a surface; Refusal for more panels than can be read."""
    cells = {tuning: Cell("refused", reason=reason) for tuning, reason in surface.refused}
    cells |= {tuning: Cell(_kind(surface, point), point) for point, tuning in enumerate(surface.tunings)}
    filtered = all(isinstance(tuning, StateTuning) for tuning in cells)
    names = [name for name in _PARAMETERS if filtered or name != "reference_filter"]
    numbers = {tuple(float(getattr(tuning, name)) for name in names): cell for tuning, cell in cells.items()}
    levels = {name: sorted(set(values)) for name, values in zip(names, zip(*numbers, strict=True), strict=True)}
    varying = [name for name in names if len(levels[name]) > 1]
    x, y, *_ = [*varying, *(name for name in names if name not in varying)]
    panels = tuple(varying[2:])
    combinations = sorted({tuple(values[names.index(name)] for name in panels) for values in numbers})
    if len(combinations) > _MAX_PANELS:
        raise Refusal(
            f"the surface would need {len(combinations)} panels, at most {_MAX_PANELS} can be seen; "
            f"give fewer values of {' and '.join(panels)}"
        )

    def cell(values: dict[str, float]) -> Cell:
        missing = "impossible" if values["prediction_horizon"] < values["move_horizon"] else "not tried"
        return numbers.get(tuple(values[name] for name in names), Cell(missing))

    rows = {}
    for combination in combinations:
        fixed = {name: values[0] for name, values in levels.items()} | dict(zip(panels, combination, strict=True))
        rows[combination] = [[cell(fixed | {x: right, y: up}) for right in levels[x]] for up in levels[y]]
    return SurfaceLayout(x, y, panels, levels, rows)


def _kind(surface: TuningSurface, point: int) -> str:
    if not np.isfinite(surface.sse[point]):
        return "not finite"
    if not surface.feasible[point]:
        return "breaks"
    return "oscillates" if surface.oscillates[point] else "kept"


def texts(names: Sequence[str], symbols: dict[str, str], values: Sequence[float]) -> str:
    """Title of a panel: the parameters and their values."""
    return ", ".join(f"{symbols[name]} = {value:g}" for name, value in zip(names, values, strict=True))


def plot_surface(
    surface: TuningSurface,
    *,
    printed: MPCTuning | None = None,
    label: str = "printed",
    title: str | None = None,
    width: Width = "double",
) -> Figure:
    """Draw the sum of squared errors of each tuning, its colour on a logarithmic scale.

    Tunings that break the constraints or oscillate are hatched. The best of the others has a star and the printed one,
    which the legend calls by its `label`, a diamond; if it is not a point of the surface, only the legend mentions it.
    Cells without a number are grey, and the legend gives the reason. Refusal for more panels than can be seen, or for
    no finite result.
    """
    places = layout(surface)
    if not np.isfinite(surface.sse).any():
        raise Refusal("the surface has no finite sum of squared errors to show")
    count = len(places.cells)
    columns = min(_PANELS_PER_ROW.get(width, 1), count)
    rows = -(-count // columns)
    figure = _style.new_figure(width, rows * _ROW_MM + _AROUND_MM, title)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    marked = {"best": surface.best() if surface.acceptable.any() else None, label: printed}
    entries: dict[str, Artist] = {}
    for number, (axes, (values, cells)) in enumerate(zip(grid.flat, places.cells.items(), strict=False)):
        image = _draw_cells(axes, surface, cells, entries)
        _draw_marks(axes, surface, cells, marked, entries)
        _style.dress(axes)
        for levels, set_ticks in (
            (places.levels[places.x], axes.set_xticks),
            (places.levels[places.y], axes.set_yticks),
        ):
            at = np.arange(0, len(levels), -(-len(levels) // _MAX_TICKS))
            set_ticks(at + 0.5, [f"{levels[place]:g}" for place in at])
        axes.set_title(texts(places.panels, _SYMBOLS, values), fontsize=FONT_PT)
        if number + columns >= count:
            # beside each other there is no room for more than the symbol
            axes.set_xlabel(_NAMES[places.x] if columns == 1 else _SYMBOLS[places.x], fontsize=FONT_PT)
            axes.tick_params(labelbottom=True)
        if number % columns == 0:
            axes.set_ylabel(_NAMES[places.y], fontsize=FONT_PT)
    for axes in grid.flat[count:]:
        axes.set_visible(False)
    if printed is not None and printed not in surface.tunings:
        entries[f"{label} {tuning_text(printed)}, beside the grid"] = _mark("D")
    _add_bar(figure, image, grid)
    _style.add_legend(figure, entries, width)
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


def _draw_cells(axes: Axes, surface: TuningSurface, rows: Sequence[Sequence[Cell]], entries: dict[str, Artist]) -> Any:
    """Colours of the cells, and hatching where there is more to say than a number."""
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Patch, PathPatch
    from matplotlib.path import Path
    from matplotlib.transforms import Affine2D

    sums = [[np.nan if cell.point is None else surface.sse[cell.point] for cell in row] for row in rows]
    finite = surface.sse[np.isfinite(surface.sse)]
    low, high = max(float(finite.min()), _LEAST), max(float(finite.max()), _LEAST)
    cells = np.ma.masked_invalid(np.maximum(np.array(sums, float), _LEAST))
    image = axes.pcolormesh(cells, cmap="viridis_r", norm=LogNorm(low, max(high, 1.01 * low)), rasterized=False)
    for kind, (hatch, face) in _LOOKS.items():
        chosen = [
            Path.unit_rectangle().transformed(Affine2D().translate(x, y))
            for y, row in enumerate(rows)
            for x, cell in enumerate(row)
            if cell.kind == kind
        ]
        if chosen:
            look: dict[str, Any] = {"edgecolor": "black", "hatch": hatch, "linewidth": 0.0}
            # one shape, so that the hatching of neighbours is one
            shape = Path.make_compound_path(*chosen)
            axes.add_patch(PathPatch(shape, facecolor=face or "none", **look, zorder=3))
            entries.setdefault(CELL_WORDS[kind], Patch(facecolor=face or "0.75", **look))
    return image


def _draw_marks(
    axes: Axes,
    surface: TuningSurface,
    rows: Sequence[Sequence[Cell]],
    tunings: dict[str, MPCTuning | None],
    entries: dict[str, Artist],
) -> None:
    """A star and a diamond on two tunings, by what they are called."""
    places = {cell.point: (x + 0.5, y + 0.5) for y, row in enumerate(rows) for x, cell in enumerate(row)}
    for marker, (label, tuning) in zip("*D", tunings.items(), strict=True):
        if tuning is not None and tuning in surface.tunings:
            point = surface.index(tuning)
            if point in places:
                axes.add_line(_mark(marker, *places[point]))
            entries.setdefault(f"{label} {tuning_text(tuning)}", _mark(marker))


def _mark(marker: str, *place: float) -> Any:
    """A marker at a place, or as it appears in the legend."""
    from matplotlib.lines import Line2D

    return Line2D(
        place[:1],
        place[1:],
        linestyle="none",
        marker=marker,
        markersize={"*": 9.0, "D": 5.0}[marker],
        markerfacecolor="white",
        markeredgecolor="black",
        markeredgewidth=0.8,
        zorder=4,
    )
