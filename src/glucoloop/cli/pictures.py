"""Files of the figures of runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from glucoloop.report import Repeat, interactive_page, plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from glucoloop.storage.folder import OutputFolder
    from glucoloop.studies.closed_loop import Outcome


def write_figure(folder: OutputFolder, name: str, figure: Figure) -> None:
    """Write a figure as PNG, SVG and PDF; the same run gives the same bytes."""
    from glucoloop.report.print_figure import figure_files

    for file, data in figure_files(name, figure).items():
        folder.write(file, data)


RUN_FILES: Final = {
    "trace.csv": "one row per sample",
    "metrics.json": "all metrics",
    "glucose_1min.parquet": "glucose every minute",
}
"""Files with the data of runs, beside their page."""


def write_pictures(
    folder: OutputFolder,
    outcomes: Mapping[str, Outcome],
    *,
    title: str,
    mmol: bool,
    facts: Mapping[str, str],
    repeat: Repeat,
) -> None:
    """Write the figure for print and the interactive page of runs in the same situation."""
    first = next(iter(outcomes.values()))
    limits, under_the_skin = first.limits, first.run.patient.under_the_skin
    traces = {label: outcome.trace for label, outcome in outcomes.items()}
    metrics = {label: outcome.metrics for label, outcome in outcomes.items()}
    write_figure(folder, "figure", plot(traces, title=title, mmol=mmol, units_per_hour=under_the_skin, limits=limits))
    page = interactive_page(
        traces if len(traces) > 1 else next(iter(traces.values())),
        metrics if len(metrics) > 1 else next(iter(metrics.values())),
        title=title,
        limits=limits,
        faults=first.run.fault_texts,
        facts=facts,
        repeat=repeat,
        mmol=mmol,
    )
    folder.write("figure.html", page)
