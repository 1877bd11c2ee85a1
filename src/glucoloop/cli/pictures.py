"""Files of the figures of runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from glucoloop.cli.screen import note
from glucoloop.patients.capabilities import SUBCUTANEOUS, insulin_route
from glucoloop.report import interactive_page, plot, plots_lack

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from glucoloop.storage.folder import OutputFolder
    from glucoloop.studies.closed_loop import Outcome


def write_figure(folder: OutputFolder, name: str, figure: Figure) -> None:
    """Write a figure as PNG, SVG and PDF; the same run gives the same bytes."""
    from glucoloop.report.print_figure import figure_files

    for file, data in figure_files(name, figure).items():
        folder.write(file, data)


def tell_what_plots_lack() -> None:
    """Print the reason why a page is written without its plots."""
    lacking = plots_lack()
    if lacking:
        note([f"The page was written without its plots. {lacking}"])


def write_pictures(folder: OutputFolder, outcomes: Mapping[str, Outcome], *, title: str, mmol: bool) -> None:
    """Write the figure for print and the interactive page of runs in the same situation."""
    first = next(iter(outcomes.values()))
    limits, under_the_skin = first.limits, insulin_route(first.run.situation.surroundings().nominal) == SUBCUTANEOUS
    traces = {label: outcome.trace for label, outcome in outcomes.items()}
    metrics = {label: outcome.metrics for label, outcome in outcomes.items()}
    write_figure(folder, "figure", plot(traces, title=title, mmol=mmol, units_per_hour=under_the_skin, limits=limits))
    tell_what_plots_lack()
    folder.write("figure.html", interactive_page(traces, metrics, title=title, limits=limits))
