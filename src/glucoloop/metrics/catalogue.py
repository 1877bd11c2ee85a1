"""Every metric, and those that a request names.

A metric joins the table and the JSON of a run, the columns of a trial, and the documentation by one entry in `METRICS`.
A metric of another package, by an entry point in the group ``glucoloop.metrics`` or as ``module:Class``, is computed
where a request names it. Nothing here imports a numerical library.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.metrics.accuracy import SensorAccuracy
from glucoloop.metrics.dosing import Constraints, Insulin, Rescues, Samples
from glucoloop.metrics.glycemia import LowEvents, MeanAndVariation, RiskIndices, TimeInRanges
from glucoloop.metrics.metric import Metric, Result
from glucoloop.metrics.regulation import Extremes, Settling, SquaredError
from glucoloop.refusal import Refusal

METRICS: Final = Catalogue(
    Metric,
    (
        TimeInRanges,
        LowEvents,
        MeanAndVariation,
        RiskIndices,
        Extremes,
        Settling,
        SquaredError,
        Insulin,
        Samples,
        Constraints,
        Rescues,
        SensorAccuracy,
    ),
    example="sensor-accuracy",
)
"""Metrics by name, in the order of tables and columns."""

_ALWAYS: Final[tuple[Metric, ...]] = tuple(metric() for metric in METRICS.values() if metric.always)
RESULTS: Final = tuple(result for metric in _ALWAYS for result in metric.results)
"""Results of the metrics that are always computed, in the order of tables and columns."""


def metrics_with(further: Iterable[str | Metric] = ()) -> Iterator[Metric]:
    """Metrics that are always computed, and further ones, as objects or by their texts.

    An unknown metric or setting, and a metric with a result of a name that another one has, are refused.
    """
    seen: dict[str, str] = {}
    requested = (METRICS.choose(metric) if isinstance(metric, str) else metric for metric in further)
    always = {metric.name for metric in _ALWAYS}
    for metric in (*_ALWAYS, *(metric for metric in requested if metric.name not in always)):
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
