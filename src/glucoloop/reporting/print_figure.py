"""Figures for print, with fonts that are embedded as TrueType."""

from __future__ import annotations

import io
from typing import Any, Final, cast

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter, Locator, ScalarFormatter

from glucoloop.display_units import OTHERS, heading_shown, in_shown_units, other_value, showing, units_shown

# Journals refuse PDF and PostScript with Type 3 fonts, matplotlib's default. In SVG letters are outlines, so that they
# look the same where the font is missing; names of clipping paths would be random without a salt.
_FOR_PRINT: Final[dict[Any, Any]] = {
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "glucoloop",
}
_NOTEBOOK_DPI: Final = 150


class _PrintFigure(Figure):
    """A figure that is saved with settings for print, wherever `savefig` is called.

    Its axes and words are in the units that were shown where it was made.
    """

    units = ""

    def draw(self, renderer: Any) -> None:
        """Draw the figure as `matplotlib.figure.Figure.draw` does."""
        with showing(self.units):
            _show_units(self)
        super().draw(renderer)

    def savefig(self, fname: Any, *, transparent: bool | None = None, **kwargs: Any) -> None:
        """Save the figure as `matplotlib.figure.Figure.savefig` does, with TrueType fonts in PDF and PostScript."""
        with matplotlib.rc_context(_FOR_PRINT):
            super().savefig(fname, transparent=transparent, **kwargs)

    def _repr_png_(self) -> bytes:
        """PNG of the figure, which a notebook shows."""
        picture = io.BytesIO()
        self.savefig(picture, format="png", dpi=_NOTEBOOK_DPI)
        return picture.getvalue()


def print_figure(size_inch: tuple[float, float]) -> Figure:
    """Make an empty figure that is saved with settings for print: in PDF and PostScript its fonts are TrueType."""
    figure = _PrintFigure(figsize=size_inch, dpi=300, layout="constrained")
    figure.units = units_shown()
    return figure


class _InOtherUnit(Locator):
    """Ticks at round numbers of another unit."""

    def __init__(self, plain: Locator, unit: str) -> None:
        self.plain = plain
        self.factor = other_value(1.0, unit)

    def __call__(self) -> Any:
        return self.tick_values(*cast(Any, self.axis).get_view_interval())

    def tick_values(self, vmin: float, vmax: float) -> Any:
        return np.asarray(self.plain.tick_values(vmin * self.factor, vmax * self.factor)) / self.factor


def _show_units(figure: Figure) -> None:
    """Bring axes and words into the units that are shown; what is there already stays."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            label = axis.label.get_text()
            unit = next((unit for unit in OTHERS if unit in label and heading_shown(unit) not in label), None)
            if unit is None or heading_shown(label) == label:
                continue
            axis.label.set_text(heading_shown(label))
            for beside in axes.child_axes:  # which shows that unit too
                if OTHERS[unit] in beside.get_ylabel():
                    beside.set_visible(False)
            locator, formatter = axis.get_major_locator(), axis.get_major_formatter()
            if isinstance(locator, FixedLocator):
                numbers = [f"{other_value(float(text.get_text()), unit):.1f}" for text in axis.get_ticklabels()]
                axis.set_ticks(axis.get_ticklocs(), labels=numbers)
            elif isinstance(formatter, ScalarFormatter):
                axis.set_major_locator(_InOtherUnit(locator, unit))
                axis.set_major_formatter(
                    FuncFormatter(
                        lambda at, _, unit=unit: f"{other_value(at, unit):.6g}".replace("-", "\N{MINUS SIGN}")
                    )
                )
    for text in figure.findobj(Text):
        words = text.get_text()
        if words != in_shown_units(words):
            text.set_text(in_shown_units(words))
