"""Heat maps: classes of colour, and figures of maps for print; the macro ``heat_maps`` shows the same maps on a page.

Maps stand side by side, or below each other where there is no room.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from glucoloop.reporting import _style
from glucoloop.reporting._style import FONT_PT, GREY, Width
from glucoloop.text import NOT_AVAILABLE

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CHARACTER_MM: Final = 1.45  # of the font
_LINE_MM: Final = 3.0
_MIN_MM: Final = 6.0  # of a column
_GAP_MM: Final = 4.0
_AROUND_MM: Final = 24.0  # title and legend
_APART: Final = 0.35  # of a row, below the first one
_MAX_NAME: Final = 30  # characters


class _Shade(NamedTuple):
    """A class of values up to `most`, with its colour and that of text on it; None for the default ones."""

    most: float
    colour: str | None
    ink: str | None
    label: str


_DARK, _LIGHT = "#1a1a1a", "#ffffff"
# Seven classes of "YlOrBr" without its palest: told apart by the colour-blind and in grey print (C. Brewer and
# M. Harrower, ColorBrewer, 2003).
SHADES_PCT: Final = (
    _Shade(0.0, None, None, "0 %"),
    _Shade(1.0, "#fff8d0", _DARK, "to 1 %"),
    _Shade(5.0, "#fee391", _DARK, "to 5 %"),
    _Shade(10.0, "#fec44f", _DARK, "to 10 %"),
    _Shade(20.0, "#fe9929", _DARK, "to 20 %"),
    _Shade(40.0, "#cc4c02", _LIGHT, "to 40 %"),
    _Shade(100.0, "#7a2604", _LIGHT, "above 40 %"),
)
"""Classes of a percentage of which any is too much."""
UNKNOWN: Final = _Shade(0.0, "#b0b0b0", _DARK, NOT_AVAILABLE)


def shade_of(value: float | None) -> _Shade:
    """Class of a value; None is unknown."""
    if value is None:
        return UNKNOWN
    return next((shade for shade in SHADES_PCT if value <= shade.most), SHADES_PCT[-1])


class HeatCell(NamedTuple):
    """A cell of a map: a text, a second, smaller one, as in ``"▲2"``, and what the page tells when it is pointed at."""

    shade: _Shade
    text: str
    mark: str = ""
    hover: str = ""


class HeatMap(NamedTuple):
    """A map: names of rows, of which the first is set apart, and of columns, and a cell for each of their pairs."""

    title: str
    rows: Sequence[str]
    columns: Sequence[str]
    cell: Callable[[str, str], HeatCell]
    apart: float = _APART
    """Space below the first row, in rows."""

    def cells(self) -> list[HeatCell]:
        """All cells, row by row."""
        return [self.cell(row, column) for row in self.rows for column in self.columns]


def legend_shades(maps: Iterable[HeatMap]) -> list[_Shade]:
    """Classes of the scale, and the one for unknown values if there are any."""
    unknown = any(cell.shade is UNKNOWN for each in maps for cell in each.cells())
    return [*SHADES_PCT, *([UNKNOWN] if unknown else [])]


def plot_heat_maps(
    maps: Sequence[HeatMap],
    *,
    what: str,
    mark: str = "",
    shades: Sequence[_Shade] | None = None,
    title: str | None = None,
    width: Width = "double",
) -> Figure:
    """Draw maps of the same rows and columns.

    The legend tells `what` the colours are, and what the `mark` of a cell means, a triangle and a number; it is empty
    for no such marks. The `shades` of the legend are by default those of percentages.
    """
    # sizes: maps below each other, upright headings, and marks below the text are for want of room
    columns = maps[0].columns
    names = [textwrap.fill(name, _MAX_NAME if width == "double" else _MAX_NAME * 2 // 3) for name in maps[0].rows]
    names_mm = _CHARACTER_MM * max(len(line) for name in names for line in name.split("\n"))
    room_mm = _style.WIDTHS_MM.get(width, 0.0) - names_mm - _GAP_MM * len(maps)
    stacked = len(maps) > 1 and room_mm < _MIN_MM * len(columns) * len(maps)
    column_mm = room_mm / len(columns) / (1 if stacked else len(maps))
    characters = max(1, int(column_mm / _CHARACTER_MM))
    upright = any(len(word) > characters for head in columns for word in head.split())
    heads = [textwrap.fill(head, _MAX_NAME if upright else characters) for head in columns]
    longest = max(len(f"{cell.text} {cell.mark}".strip()) for each in maps for cell in each.cells())
    two_lines = column_mm < _CHARACTER_MM * longest
    row_mm = _LINE_MM * max(2 if two_lines else 1, *(name.count("\n") + 1 for name in names)) + 1.2
    head_mm = _LINE_MM * (2 + max(head.count("\n") for head in heads))
    if upright:
        head_mm = _CHARACTER_MM * max(map(len, heads)) + _LINE_MM

    down = len(maps) if stacked else 1
    figure = _style.new_figure(width, down * (len(names) * row_mm + head_mm + _GAP_MM) + _AROUND_MM, title)
    panels = figure.subplots(down, len(maps) // down, squeeze=False).ravel()
    for place, (axes, heat_map) in enumerate(zip(panels, maps, strict=True)):
        places = _draw(axes, heat_map, apart="\n" if two_lines else " ")
        axes.set_xticks(range(len(columns)), map(_style.literal, heads), rotation=90 if upright else 0)
        axes.set_yticks(places, map(_style.literal, names))
        _style.dress(axes)
        axes.tick_params(length=0.0, labeltop=True, labelbottom=False, top=False, bottom=False)
        axes.spines[:].set_visible(False)
        axes.set_title(heat_map.title, fontsize=FONT_PT, fontweight="bold", loc="left")
        if place and not stacked:
            axes.tick_params(labelleft=False)
    entries = _legend(legend_shades(maps) if shades is None else shades, what, mark)
    _style.add_legend(figure, entries, width)
    return figure


def _draw(axes: Axes, heat_map: HeatMap, apart: str) -> list[float]:
    """Draw the cells of a map, and tell the places of its rows."""
    from matplotlib.patches import Rectangle

    places = [place + (heat_map.apart if place else 0.0) for place in range(len(heat_map.rows))]
    for place, row in zip(places, heat_map.rows, strict=True):
        for across, column in enumerate(heat_map.columns):
            cell = heat_map.cell(row, column)
            axes.add_patch(Rectangle((across - 0.48, place - 0.46), 0.96, 0.92, **_patch(cell.shade)))
            text, ink = apart.join(filter(None, (cell.text, cell.mark))), cell.shade.ink or "black"
            _style.write(axes, text, (across, place), va="center", color=ink, linespacing=1.0)
    axes.set(xlim=(-0.5, len(heat_map.columns) - 0.5), ylim=(places[-1] + 0.5, -0.5))
    return places


def _patch(shade: _Shade) -> dict[str, Any]:
    return {"facecolor": shade.colour or "none", "edgecolor": "none" if shade.colour else "0.8", "linewidth": 0.5}


def _legend(shades: Sequence[_Shade], what: str, mark: str) -> dict[str, Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: dict[str, Artist] = {
        shade.label if place else f"{shade.label} {what}": Patch(**_patch(shade)) for place, shade in enumerate(shades)
    }
    if mark:
        entries[mark] = Line2D([], [], color=GREY, marker="^", markersize=4.0, linestyle="none")
    return entries
