"""Figures as files for print: fonts are embedded as TrueType, and the same figure gives the same bytes."""

from __future__ import annotations

import io
from typing import Any, Final

import matplotlib
from matplotlib.figure import Figure

KINDS: Final = ("png", "svg", "pdf")
"""File formats in which a command writes each figure."""

# Journals refuse PDF and PostScript with Type 3 fonts, matplotlib's default. In SVG letters are outlines, so that they
# look the same where the font is missing; names of clipping paths would be random without a salt.
_FOR_PRINT: Final[dict[Any, Any]] = {
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "glucoloop",
}
_UNDATED: Final[dict[str, dict[str, None]]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


class _PrintFigure(Figure):
    """A figure that is saved with settings for print, wherever `savefig` is called."""

    def savefig(self, fname: Any, *, transparent: bool | None = None, **kwargs: Any) -> None:
        """Save the figure as `matplotlib.figure.Figure.savefig` does, with TrueType fonts in PDF and PostScript."""
        with matplotlib.rc_context(_FOR_PRINT):
            super().savefig(fname, transparent=transparent, **kwargs)


def print_figure(size_inch: tuple[float, float]) -> Figure:
    """Make an empty figure that is saved with settings for print: in PDF and PostScript its fonts are TrueType."""
    return _PrintFigure(figsize=size_inch, dpi=300, layout="constrained")


def figure_bytes(figure: Figure, kind: str) -> bytes:
    """File of a figure in one of `KINDS`, without a date."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, metadata=_UNDATED.get(kind))
    return buffer.getvalue()


def figure_files(name: str, figure: Figure) -> dict[str, bytes]:
    """A figure as PNG, SVG and PDF, by the names of the files; the same for the same run, and laid out once for all."""
    layout = figure.get_layout_engine()
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # positions stay where they are
    try:
        return {f"{name}.{kind}": figure_bytes(figure, kind) for kind in KINDS}
    finally:
        figure.set_layout_engine(layout)
