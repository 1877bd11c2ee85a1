"""Summary of a trial: distributions of metrics, the people with the worst outcomes, and people left out.

Shards are read one at a time, repeatedly if necessary, so that memory does not grow with the number of people; all
numbers are exact, and depend only on the shards.
"""

from __future__ import annotations

import dataclasses
import heapq
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.metrics.control_variability import CELLS, grid_counts
from glucoloop.refusal import Refusal
from glucoloop.trials.people import PeopleRows, Shards
from glucoloop.trials.statistics import (
    CONFIDENCE_PCT,
    Floats,
    Moments,
    PairedDifferences,
    finite,
    mean_interval,
    quantiles,
    share_interval,
)

QUANTILES: Final = {"p1": 0.01, "p5": 0.05, "p25": 0.25, "median": 0.5, "p75": 0.75, "p95": 0.95, "p99": 0.99}
MAX_NAMED: Final = 1000
"""Largest number of people that are listed by number; beyond it they are only counted."""
_WORST: Final = 10
LOW_MG_DL: Final = (70, 60, 54)
DISTRIBUTIONS: Final = (
    "undershoot_mg_dl",
    "time_below_60_pct",
    "peak_mg_dl",
    "mean_mg_dl",
    "settling_5pct_min",
    "insulin_total_mU",
)
"""Metrics that are counted in bins."""
_BINS: Final = 60


@dataclass
class _AffectedPeople:
    """People for whom a condition holds."""

    count: int = 0
    person: list[int] = field(default_factory=list)
    """Numbers of the people, at most the first 1000."""

    def add(self, person: npt.NDArray[np.int64]) -> None:
        """Include more people."""
        self.count += person.size
        self.person += person[: max(0, MAX_NAMED - len(self.person))].tolist()


@dataclass(frozen=True)
class _Histogram:
    """Number of people with a metric in each bin; values beyond the edges are counted in the outermost bins."""

    edges: Floats
    """(bins + 1,) edges from the minimum p1 to the maximum p99 of all controllers."""
    counts: npt.NDArray[np.int64]
    """(bins,) numbers of people."""


@dataclass(frozen=True)
class TrialSummary:
    """Results of a trial."""

    plain: dict[str, Any]
    """Numbers as plain values for JSON: of the people, those who are ``unable`` to rest at the setpoint and those whose
    basal rate is beyond the pump; of each controller its ``metrics`` (mean with its interval of 95 %, ``low`` to
    ``high``, sd, min, p1 to p99 and max, and the number of people where some have no value; for one that is 0 or 1, the
    number of people with 1, and their share with its interval), those who were ``ever_below`` a glucose, those below
    the range in which their model is valid, which means severe hypoglycemia and not a number, those whose glucose or
    insulin was not finite, who are in no other number, and the ten with the minimum glucose, the minimum first; and
    ``differences`` of each controller from the first one, person by person, see `trials.statistics`.
    """
    cvga_counts: Mapping[str, npt.NDArray[np.int64]]
    """People in each cell of the control-variability grid, by controller."""
    distributions: Mapping[str, Mapping[str, _Histogram]]
    """Histogram of each metric in `DISTRIBUTIONS`, by controller."""


class _Case:
    """Counts of one controller from the first reading."""

    def __init__(self, people: PeopleRows) -> None:
        self.yes_or_no = people.yes_or_no
        self.moments = {name: Moments() for name in people.metrics}
        self.below_validity = _AffectedPeople()
        self.not_finite = _AffectedPeople()
        self.worst: list[tuple[float, int, dict[str, Any]]] = []
        self.ever_below = dict.fromkeys(LOW_MG_DL, 0)
        self.cvga = np.zeros((3 * CELLS, 3 * CELLS), np.int64)

    def add(self, people: PeopleRows) -> None:
        known = _known(people)
        self.not_finite.add(people.person[people.feasible & ~known])
        self.below_validity.add(people.person[known & people.below_validity])
        for name, values in _columns(people).items():
            self.moments[name].add(finite(values))
        minimum = people.metrics["minimum_mg_dl"][known]
        self.cvga += grid_counts(minimum, people.metrics["peak_mg_dl"][known])
        for limit in LOW_MG_DL:
            self.ever_below[limit] += int((minimum < limit).sum())
        rows = np.flatnonzero(known)[np.argsort(minimum, kind="stable")[:_WORST]]
        result = [(float(people.metrics["minimum_mg_dl"][i]), int(people.person[i]), _row(people, i)) for i in rows]
        self.worst = heapq.nsmallest(_WORST, [*self.worst, *result], key=lambda one: one[:2])

    def plain(self, result: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
        people = next(iter(self.moments.values())).count
        return {
            "metrics": {
                name: _share(round(moment.mean * moment.count), moment.count)
                if name in self.yes_or_no
                else _spread(moment, result[name], people)
                for name, moment in self.moments.items()
            },
            "ever_below": {f"{limit}_mg_dl": _share(count, people) for limit, count in self.ever_below.items()},
            "below_validity": dataclasses.asdict(self.below_validity),
            "not_finite": dataclasses.asdict(self.not_finite),
            "worst": [row for _, _, row in self.worst],
        }


def summarise_people(shards: Shards, *, max_insulin_mU_min: float) -> TrialSummary:
    """Summary of a trial from its shards, which are read in order; the bound is the maximum rate of the pump.

    Refusal if there is no shard.
    """
    cases: dict[str, _Case] = {}
    paired: dict[str, PairedDifferences] = {}
    infeasible, beyond = _AffectedPeople(), _AffectedPeople()
    people = 0
    for shard in shards():
        for label, of_label in shard.items():
            cases.setdefault(label, _Case(of_label)).add(of_label)
        reference, *others = shard
        first = shard[reference]  # who has a basal rate, and which, does not depend on the controller
        for label in others:
            known = _known(first) & _known(shard[label])
            paired.setdefault(label, PairedDifferences(LOW_MG_DL)).add(first, shard[label], known)
        people += first.person.size
        infeasible.add(first.person[~first.feasible])
        beyond.add(first.person[first.feasible & (first.basal_insulin_mU_min > max_insulin_mU_min)])
    if not cases:
        raise Refusal("there is nobody to summarise; finish a shard first")
    result = _quantiles(shards, cases)
    differences = {label: of.plain() for label, of in paired.items()}
    return TrialSummary(
        plain={
            "people": people,
            "able": people - infeasible.count,
            "unable": dataclasses.asdict(infeasible),
            "basal_beyond_pump": dataclasses.asdict(beyond),
            "controllers": {label: case.plain(result[label]) for label, case in cases.items()},
            "differences": {
                "reference": next(iter(cases)),
                "confidence_pct": CONFIDENCE_PCT,
                "controllers": differences,
            },
        },
        cvga_counts={label: case.cvga for label, case in cases.items()},
        distributions=_distributions(shards, result),
    )


def _quantiles(shards: Shards, cases: Mapping[str, _Case]) -> dict[str, dict[str, dict[str, float]]]:
    """Quantiles of each metric by controller; the columns of all controllers are read together."""

    def parts() -> Iterator[list[Floats]]:
        for shard in shards():
            yield [values for label in cases for values in _columns(shard[label]).values()]

    counts = [
        0 if name in case.yes_or_no else moment.count
        for case in cases.values()
        for name, moment in case.moments.items()
    ]
    result = iter(quantiles(parts, counts, list(QUANTILES.values())).tolist())
    return {
        label: {name: dict(zip(QUANTILES, next(result), strict=True)) for name in case.moments}
        for label, case in cases.items()
    }


def _distributions(
    shards: Shards, result: Mapping[str, Mapping[str, Mapping[str, float]]]
) -> dict[str, dict[str, _Histogram]]:
    """Histograms between edges that all controllers share, from the quantiles of each."""
    counted: dict[str, dict[str, _Histogram]] = {label: {} for label in result}
    for metric in DISTRIBUTIONS:
        ends = np.array([[metrics[metric]["p1"], metrics[metric]["p99"]] for metrics in result.values()])
        low, high = (ends[:, 0].min(), ends[:, 1].max()) if np.isfinite(ends).all() else (0.0, 1.0)
        edges = np.linspace(low, high if high > low else low + 1.0, _BINS + 1)
        for label in result:
            counted[label][metric] = _Histogram(edges, np.zeros(_BINS, np.int64))
    for shard in shards():
        for label, histograms in counted.items():
            values = _columns(shard[label])
            for metric, histogram in histograms.items():
                clipped = np.clip(values[metric], histogram.edges[0], histogram.edges[-1])
                histogram.counts[:] += np.histogram(clipped, histogram.edges)[0]
    return counted


def _columns(people: PeopleRows) -> dict[str, Floats]:
    """Values of each metric for the people all of whose metrics are known."""
    known = _known(people)
    return {name: values[known] for name, values in people.metrics.items()}


def _known(people: PeopleRows) -> npt.NDArray[np.bool_]:
    finite_of = (np.isfinite(people.metrics[name]) for name in ("minimum_mg_dl", "insulin_total_mU"))
    known: npt.NDArray[np.bool_] = np.logical_and.reduce([people.feasible, *finite_of])
    return known


def _row(people: PeopleRows, index: int) -> dict[str, Any]:
    """One person, as plain values."""
    drawn = {name: float(values[index]) for name, values in people.drawn.items()}
    metrics = {name: float(values[index]) for name, values in people.metrics.items()}
    return {
        "person": int(people.person[index]),
        "basal_insulin_mU_min": float(people.basal_insulin_mU_min[index]),
        "parameters": drawn,
        "metrics": {name: bool(value) if name in people.yes_or_no else value for name, value in metrics.items()},
    }


def _share(count: int, total: int) -> dict[str, float]:
    low, high = share_interval(count, total)
    return {"people": count, "share_pct": 100.0 * count / total if total else float("nan"), "low": low, "high": high}


def _spread(moment: Moments, result: Mapping[str, float], people: int) -> dict[str, float]:
    mean, least, greatest = (moment.mean, moment.least, moment.greatest) if moment.count else (float("nan"),) * 3
    having = {} if moment.count == people else {"people": moment.count}
    low, high = mean_interval(moment)
    return {"mean": mean, "low": low, "high": high, "sd": moment.sd, "min": least, **result, "max": greatest, **having}
