"""Figures of runs, as files."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

from glucoloop.cli.screen import note
from glucoloop.report import interactive_page, plot, plots_lack

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from glucoloop.cli.closed_loop import Outcome
    from glucoloop.storage.folder import OutputFolder


def figure_files(name: str, figure: Figure) -> dict[str, bytes]:
    """A figure as PNG and SVG, by the names of the files; the same for the same run."""
    import matplotlib

    files = {}
    for kind in ("png", "svg"):
        buffer = io.BytesIO()
        # An SVG file would hold its date, and names drawn by chance.
        with matplotlib.rc_context({"svg.hashsalt": "glucoloop"}):
            figure.savefig(buffer, format=kind, metadata={"Date": None} if kind == "svg" else None)
        files[f"{name}.{kind}"] = buffer.getvalue()
    return files


def write_figure(folder: OutputFolder, name: str, figure: Figure) -> None:
    """A figure as PNG and SVG, the same for the same run."""
    for file, data in figure_files(name, figure).items():
        folder.write(file, data)


def tell_what_plots_lack() -> None:
    """Say why a page is written without its plots."""
    lacking = plots_lack()
    if lacking:
        note([f"The page is written without its plots. {lacking}"])


def write_pictures(folder: OutputFolder, outcomes: Mapping[str, Outcome], *, title: str, mmol: bool) -> None:
    """The figure for print and the page to zoom into, of runs in the same situation."""
    limits = next(iter(outcomes.values())).limits
    traces = {label: outcome.trace for label, outcome in outcomes.items()}
    metrics = {label: outcome.metrics for label, outcome in outcomes.items()}
    write_figure(folder, "figure", plot(traces, title=title, mmol=mmol, limits=limits))
    tell_what_plots_lack()
    folder.write("figure.html", interactive_page(traces, metrics, title=title, limits=limits))
