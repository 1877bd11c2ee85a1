"""Every metric, and those that a request names.

A metric joins the table and the JSON of a run, the columns of a trial, and the documentation by one entry in `METRICS`.
A metric of another package, by an entry point in the group ``glucoloop.metrics`` or as ``module:Class``, is computed
where a request names it. Nothing here imports a numerical library.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator
from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.metrics.metric import Metric, Result
from glucoloop.refusal import Refusal

METRICS: Final = Catalogue(
    Metric,
    {
        "time-in-ranges": "glucoloop.metrics.glycemia:TimeInRanges",
        "low-events": "glucoloop.metrics.glycemia:LowEvents",
        "mean-and-variation": "glucoloop.metrics.glycemia:MeanAndVariation",
        "risk-indices": "glucoloop.metrics.glycemia:RiskIndices",
        "extremes": "glucoloop.metrics.regulation:Extremes",
        "settling": "glucoloop.metrics.regulation:Settling",
        "squared-error": "glucoloop.metrics.regulation:SquaredError",
        "insulin": "glucoloop.metrics.dosing:Insulin",
        "insulin-on-board": "glucoloop.metrics.dosing:InsulinOnBoard",
        "samples": "glucoloop.metrics.dosing:Samples",
        "constraints": "glucoloop.metrics.dosing:Constraints",
        "rescues": "glucoloop.metrics.dosing:Rescues",
        "glucagon": "glucoloop.metrics.dosing:Glucagon",
        "sensor-accuracy": "glucoloop.metrics.accuracy:SensorAccuracy",
    },
    example="sensor-accuracy",
)
"""Metrics by name, in the order of tables and columns."""


@functools.cache
def _always() -> tuple[Metric, ...]:
    """Metrics that are computed in every run."""
    return tuple(metric() for metric in METRICS.values() if metric.always)


def default_results() -> tuple[Result, ...]:
    """Results of the metrics that are computed in every run, in the order of tables and columns."""
    return tuple(result for metric in _always() for result in metric.results)


def metrics_with(further: Iterable[str | Metric] = ()) -> Iterator[Metric]:
    """Metrics that are always computed, and further ones, as objects or by their texts.

    An unknown metric or setting, and a metric with a result of a name that another one has, are refused.
    """
    seen: dict[str, str] = {}
    requested = (METRICS.choose(metric) if isinstance(metric, str) else metric for metric in further)
    always = {metric.name for metric in _always()}
    for metric in (*_always(), *(metric for metric in requested if metric.name not in always)):
        for result in metric.results:
            if result.name in seen:
                raise Refusal(
                    f"the metric {metric.name} gives {result.name}, which the metric {seen[result.name]} gives "
                    "already; leave one of them out, or rename it"
                )
            seen[result.name] = metric.name
        yield metric


def result_named(name: str, further: Iterable[str] = ()) -> Result:
    """Description of a result by its name; Refusal for a name that no metric has."""
    known = {result.name: result for metric in metrics_with(further) for result in metric.results}
    if name not in known:
        raise Refusal(f"unknown metric {name!r}; use one of {', '.join(known)}")
    return known[name]
