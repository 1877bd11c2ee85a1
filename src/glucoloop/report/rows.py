"""Rows of a table of metrics: name, unit and format of each metric."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from glucoloop.metrics import Metrics
from glucoloop.parts.metrics import Result, metrics_with
from glucoloop.printable import NOT_AVAILABLE
from glucoloop.refusal import Refusal
from glucoloop.units import MG_DL_PER_MMOL_L


@dataclass(frozen=True)
class Row:
    """One metric of one run or of several."""

    section: str
    name: str
    unit: str
    values: tuple[str, ...]
    mmol_l: tuple[str, ...] | None = None
    """The values in mmol/l, of a metric in mg/dl."""


def metric_rows(metrics: Mapping[str, Metrics]) -> list[Row]:
    """Rows for runs by label, one value per run; a time that is only a lower bound ends in "+".

    Raises
    ------
    ValueError
        If there are no metrics, or some are of many people.
    """
    if not metrics:
        raise Refusal("there are no metrics to show; give those of at least one run")
    plain = [of_run.as_dict() for of_run in metrics.values()]
    return [
        _row(metric.section, result, plain)
        for metric in metrics_with(next(iter(metrics.values())).further)
        for result in metric.results
        if result.title and (not result.seldom or any(values[result.name] for values in plain))
    ]


def _row(section: str, result: Result, metrics: Sequence[Mapping[str, float | int | bool | None]]) -> Row:
    values = tuple(_cell(result, of_run) for of_run in metrics)
    if result.unit != "mg/dl":
        return Row(section, result.title, result.unit, values)
    other = dataclasses.replace(result, digits=2, divisor=MG_DL_PER_MMOL_L)
    return Row(section, result.title, result.unit, values, tuple(_cell(other, of_run) for of_run in metrics))


def _cell(result: Result, metrics: Mapping[str, float | int | bool | None]) -> str:
    """A value of one run as text."""
    value = metrics[result.name]
    if value is None or isinstance(value, bool):
        return NOT_AVAILABLE if value is None else "yes" if value else "no"
    least, fall = metrics["minimum_mg_dl"], metrics["undershoot_mg_dl"]
    setpoint = math.inf if least is None or fall is None else least + fall
    return result.text(value, setpoint) + ("+" if result.settled and not metrics[result.settled] else "")
