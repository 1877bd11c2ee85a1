"""Figure of a stress test, ready for print: maps of faults and controllers, without and with the guard."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from glucoloop.report import _style
from glucoloop.report._style import FONT_PT, GREY, Width
from glucoloop.studies.stress._cells import legend_shades, shade_of, short_pct
from glucoloop.studies.stress._grid import GUARDS, Grid, grid_of
from glucoloop.studies.stress.stress import MOST_MORE_PCT, NO_FAULT, StressResult, StressRow

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CHARACTER_MM: Final = 1.45  # of the font
_LINE_MM: Final = 3.0
_LEAST_MM: Final = 6.0  # of a column
_GAP_MM: Final = 4.0
_AROUND_MM: Final = 24.0  # title and legend
_SET_APART: Final = 0.35  # of a row, between no fault and the faults
_MOST_NAME: Final = 30  # characters


@dataclass(frozen=True)
class _Sheet:
    """Sizes of all parts of the figure."""

    stacked: bool
    """Whether the maps stand below each other."""
    two_lines: bool
    """Whether the numbers of a cell stand below each other."""
    names: list[str]
    heads: list[str]
    upright: bool
    """Whether the names of controllers are rotated."""

    @property
    def row_mm(self) -> float:
        """Height of a row of cells."""
        lines = max(2 if self.two_lines else 1, *(name.count("\n") + 1 for name in self.names))
        return _LINE_MM * lines + 1.2

    @property
    def head_mm(self) -> float:
        """Height above the cells, with the title."""
        if self.upright:
            return _CHARACTER_MM * max(map(len, self.heads)) + _LINE_MM
        return _LINE_MM * (2 + max(head.count("\n") for head in self.heads))


def plot_stress(result: StressResult, *, title: str | None = None, width: Width = "double") -> Figure:
    """Draw a stress test: a map without the guard and one with it, a row for each fault, a column for each controller.

    The number and the colour of a cell are the percentage of the time below 60 mg/dl of the person who was longest
    below; beside a triangle is the number of people who were worse off than without the fault.

    Parameters
    ----------
    result : StressResult
    title : str, optional
        Title; no title by default.
    width : {"single", "double"}
        Width of a printed column: 88 or 180 mm.

    Returns
    -------
    matplotlib.figure.Figure
        Figure outside pyplot's state; write it with ``savefig`` to SVG, PDF or PNG (300 dots per inch).

    Raises
    ------
    ValueError
        For an unknown width, if there are no rows, or if they do not make a grid.
    """
    grid = grid_of(result)
    sheet = _sheet(grid, width)
    maps = len(grid.guards)
    down = maps if sheet.stacked else 1
    height = down * (len(grid.faults) * sheet.row_mm + sheet.head_mm + _GAP_MM) + _AROUND_MM
    figure = _style.new_figure(width, height, title)
    panels = figure.subplots(down, maps // down, squeeze=False).ravel()
    for place, (axes, guarded) in enumerate(zip(panels, grid.guards, strict=True)):
        _draw(axes, grid, guarded, sheet)
        axes.set_title(GUARDS[guarded].capitalize(), fontsize=FONT_PT, fontweight="bold", loc="left")
        if place and not sheet.stacked:
            axes.tick_params(labelleft=False)
    entries = _legend(grid)
    _style.add_legend(figure, list(entries.values()), list(entries), width)
    return figure


def _sheet(grid: Grid, width: Width) -> _Sheet:
    most = _MOST_NAME if width == "double" else _MOST_NAME * 2 // 3
    names = [textwrap.fill(grid.names[fault], most) for fault in grid.faults]
    names_mm = _CHARACTER_MM * max(len(line) for name in names for line in name.split("\n"))
    room_mm = _style.WIDTHS_MM.get(width, 0.0) - names_mm - _GAP_MM * len(grid.guards)
    beside_mm = room_mm / (len(grid.controllers) * len(grid.guards))
    stacked = len(grid.guards) > 1 and beside_mm < _LEAST_MM
    column_mm = room_mm / len(grid.controllers) if stacked else beside_mm
    characters = int(column_mm / _CHARACTER_MM)
    upright = any(len(word) > characters for head in grid.controllers for word in head.split())
    heads = [textwrap.fill(head, _MOST_NAME if upright else characters) for head in grid.controllers]
    return _Sheet(
        stacked=stacked,
        two_lines=column_mm < _CHARACTER_MM * max(len(_told(row, two_lines=False)) for row in grid.rows.values()),
        names=[_style.literal(name) for name in names],
        heads=[_style.literal(head) for head in heads],
        upright=upright,
    )


def _draw(axes: Axes, grid: Grid, guarded: bool, sheet: _Sheet) -> None:
    from matplotlib.patches import Rectangle

    places = [row + (_SET_APART if fault != NO_FAULT else 0.0) for row, fault in enumerate(grid.faults)]
    for place, fault in zip(places, grid.faults, strict=True):
        for column, controller in enumerate(grid.controllers):
            row = grid.row(controller, guarded, fault)
            shade = shade_of(row)
            axes.add_patch(
                Rectangle(
                    (column - 0.48, place - 0.46),
                    0.96,
                    0.92,
                    facecolor=shade.colour or "none",
                    edgecolor="none" if shade.colour else "0.8",
                    linewidth=0.5,
                )
            )
            axes.annotate(
                _told(row, two_lines=sheet.two_lines),
                (column, place),
                ha="center",
                va="center",
                color=shade.ink or "black",
                fontsize=FONT_PT,
                linespacing=1.0,
            )
    axes.set_xlim(-0.5, len(grid.controllers) - 0.5)
    axes.set_ylim(places[-1] + 0.5, -0.5)
    axes.set_xticks(range(len(grid.controllers)), sheet.heads, rotation=90 if sheet.upright else 0)
    axes.set_yticks(places, sheet.names)
    _style.dress(axes)
    axes.tick_params(length=0.0, labeltop=True, labelbottom=False, top=False, bottom=False)
    axes.spines[:].set_visible(False)


def _told(row: StressRow, *, two_lines: bool) -> str:
    worse = f"▲{len(row.worse)}" if row.worse else ""
    return ("\n" if two_lines else " ").join(filter(None, (short_pct(row.below_60_worst_pct), worse)))


def _legend(grid: Grid) -> dict[str, Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: dict[str, Artist] = {
        shade.words + (" of the time below 60 mg/dl" if place == 0 else ""): Patch(
            facecolor=shade.colour or "none", edgecolor="none" if shade.colour else "0.8", linewidth=0.5
        )
        for place, shade in enumerate(legend_shades(grid.rows.values()))
    }
    entries[f"people below for {MOST_MORE_PCT:g} % of the time more than without the fault"] = Line2D(
        [], [], color=GREY, marker="^", markersize=4.0, linestyle="none"
    )
    return entries
