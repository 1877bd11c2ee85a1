"""Tables of metrics: a line for each number and a column for each run, for the terminal and for pages."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from glucoloop.bounds import Distance
from glucoloop.metrics import Metrics
from glucoloop.parts.metrics import Result, metrics_with
from glucoloop.printable import NOT_AVAILABLE
from glucoloop.refusal import Refusal
from glucoloop.units import MG_DL_PER_MMOL_L

if TYPE_CHECKING:
    from rich.table import Table

_OF_A_BOUND: Final = {
    "Largest deviation": "deviation_mg_dl",
    "Bound": "bound_mg_dl",
    "Distance to the bound": "distance_mg_dl",
}


class MetricRow(NamedTuple):
    """One metric of one run or of several, in mmol/l too if it is in mg/dl; in the terminal with its `statistic`."""

    section: str
    name: str
    unit: str
    values: Sequence[str]
    mmol_l: Sequence[str] | None = None
    statistic: str = ""


def metric_rows(metrics: Mapping[str, Metrics]) -> list[MetricRow]:
    """Rows for runs by label, one value per run; a time that is only a lower bound ends in "+"."""
    if not metrics:
        raise Refusal("there are no metrics to show; give those of at least one run")
    plain = [of_run.as_dict() for of_run in metrics.values()]
    rows = []
    for metric in metrics_with(next(iter(metrics.values())).further):
        for result in metric.results:
            if result.title and (not result.seldom or any(values[result.name] for values in plain)):
                texts, mmol_l = [_text(result, of_run) for of_run in plain], None
                if result.unit == "mg/dl":
                    other = dataclasses.replace(result, digits=2, divisor=MG_DL_PER_MMOL_L)
                    mmol_l = [_text(other, of_run) for of_run in plain]
                rows.append(MetricRow(metric.section, result.title, result.unit, texts, mmol_l))
    return rows


def _text(result: Result, metrics: Mapping[str, float | int | bool | None]) -> str:
    """A value of one run as text."""
    value = metrics[result.name]
    if value is None or isinstance(value, bool):
        return NOT_AVAILABLE if value is None else "yes" if value else "no"
    least, fall = metrics["minimum_mg_dl"], metrics["undershoot_mg_dl"]
    setpoint = math.inf if least is None or fall is None else least + fall
    return result.text(value, setpoint) + ("+" if result.settled and not metrics[result.settled] else "")


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
    return lines_table("Metric", ["Value"], metric_rows({"Value": metrics}))


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
    rows = metric_rows(metrics)
    if distances is not None:
        for name, field in _OF_A_BOUND.items():
            values = [f"{getattr(distances[at], field):z.2f}" if at in distances else NOT_AVAILABLE for at in metrics]
            rows.append(MetricRow("Bound", name, "mg/dl", values))
    return lines_table("Metric", metrics, rows)


def lines_table(head: str, labels: Iterable[str], rows: Sequence[MetricRow]) -> Table:
    """A table for the terminal; piped, it is plain text."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(head, no_wrap=True)
    statistics = any(row.statistic for row in rows)
    if statistics:
        table.add_column("")
    for label in labels:
        # Text, since square brackets in a label would be taken for markup
        table.add_column(Text(label), justify="right")
    table.add_column("Unit", no_wrap=True)
    section = ""
    for row in rows:
        if row.section != section:
            if section:
                table.add_section()
            section = row.section
            table.add_row(Text(section, "bold"))
        name = f"  {row.name}" if row.section else row.name
        table.add_row(name, *([row.statistic] if statistics else []), *row.values, row.unit)
    return table
