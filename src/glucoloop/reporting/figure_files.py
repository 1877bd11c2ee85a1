"""Figures as files: the same figure gives the same bytes. Matplotlib is imported where a figure has been made."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS: Final = ("png", "svg", "pdf")
"""File formats in which a command writes each figure."""

_UNDATED: Final[dict[str, dict[str, None]]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


def _figure_bytes(figure: Figure, kind: str) -> bytes:
    """File of a figure in one of `KINDS`, without a date."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, metadata=_UNDATED.get(kind))
    return buffer.getvalue()


def figure_files(name: str, figure: Figure) -> dict[str, bytes]:
    """A figure as PNG, SVG and PDF, by the names of the files; the same for the same run, and laid out once for all."""
    import matplotlib  # which has been imported where a figure was made

    layout = figure.get_layout_engine()
    figure.draw_without_rendering()
    with matplotlib.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
        figure.set_layout_engine(
            None
        )  # positions stay where they are; even an engine that does nothing draws once more
    try:
        return {f"{name}.{kind}": _figure_bytes(figure, kind) for kind in KINDS}
    finally:
        figure.set_layout_engine(layout)
