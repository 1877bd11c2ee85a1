"""Tables of metrics for the terminal; piped, they are plain text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from glucoloop.bounds import Distance
from glucoloop.metrics import Metrics
from glucoloop.printable import NOT_AVAILABLE
from glucoloop.report.rows import metric_rows

if TYPE_CHECKING:
    from rich.table import Table


def metrics_table(metrics: Metrics) -> Table:
    """Name, value and unit of each metric of one run.

    Parameters
    ----------
    metrics : Metrics
        Metrics of one person.

    Returns
    -------
    rich.table.Table

    Raises
    ------
    ValueError
        For metrics of many people.
    """
    return _table({"Value": metrics})


def comparison_table(metrics: Mapping[str, Metrics], distances: Mapping[str, Distance] | None = None) -> Table:
    """Metrics of several runs side by side, under their labels.

    Parameters
    ----------
    metrics : mapping of str to Metrics
        Metrics of one person each, by label.
    distances : mapping of str to Distance, optional
        Distances to the bound of the situation, under the same labels, for a further section; a run for which the
        bound does not hold has none.

    Returns
    -------
    rich.table.Table

    Raises
    ------
    ValueError
        If there are none, or some are of many people.
    """
    table = _table(metrics)
    if distances is not None:
        from rich.text import Text

        rows = {
            "Largest deviation": "deviation_mg_dl",
            "Bound": "bound_mg_dl",
            "Distance to the bound": "distance_mg_dl",
        }
        table.add_section()
        table.add_row(Text("Bound", "bold"))
        for name, field in rows.items():
            values = [
                f"{getattr(distances[label], field):z.2f}" if label in distances else NOT_AVAILABLE for label in metrics
            ]
            table.add_row(*_cells(name, values, "mg/dl"))
    return table


def _table(metrics: Mapping[str, Metrics]) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    rows = metric_rows(metrics)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("Metric", no_wrap=True)
    for label in metrics:
        # Text, since square brackets in a label would be taken for markup
        table.add_column(Text(label), justify="right")
    table.add_column("Unit", no_wrap=True)
    for before, row in zip([None, *rows], rows, strict=False):
        if before is None or before.section != row.section:
            if before is not None:
                table.add_section()
            table.add_row(Text(row.section, "bold"))
        table.add_row(*_cells(row.name, row.values, row.unit))
    return table


def _cells(name: str, values: Sequence[str], unit: str) -> list[str]:
    return [f"  {name}", *values, unit]
