"""What a page or a figure shows of a trial: plain numbers, counted and summed elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.metrics import LOWEST_GLUCOSE_MG_DL
from glucoloop.report.rows import described

Floats = npt.NDArray[np.float64]

QUANTILES: Final = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
"""The quantiles that bands are drawn between."""

RANGES: Final = ("below 54", "54 to 70", "70 to 180", "180 to 250", "above 250")
"""The ranges of glucose [mg/dl] that time is shared out between."""


@dataclass(frozen=True)
class Distribution:
    """How a metric is spread over the people."""

    edges: Floats
    """(bins + 1,) in the metric's own unit; the same for every controller."""
    counts: npt.NDArray[Any]
    """(bins,) people; those beyond the edges are counted in the outermost bins."""
    p5: float
    """The metric that 5 % of the people stay below."""
    median: float
    p95: float


@dataclass(frozen=True)
class WorstPerson:
    """One of those who fared worst, with what happened to him."""

    person: int
    """His number in the population."""
    minimum_mg_dl: float
    """His least glucose."""
    t_min: Floats
    """(points,) of his glucose."""
    glucose_mg_dl: Floats
    """(points,) free of noise."""
    insulin_t_min: Floats
    """(samples,) since when each rate was delivered."""
    insulin_mU_min: Floats
    """(samples,)"""
    note: str = ""
    """What sets him apart, in a phrase."""


@dataclass(frozen=True)
class CaseReport:
    """What one controller came to."""

    bands_t_min: Floats
    """(samples + 1,) the samples and the horizon."""
    glucose_quantiles: Mapping[float, Floats]
    """(samples + 1,) of glucose [mg/dl] over the people, for each of `QUANTILES`."""
    insulin_t_min: Floats
    """(samples,) since when each rate was delivered."""
    insulin_quantiles: Mapping[float, Floats]
    """(samples,) of delivered insulin [mU/min] over the people, for each of `QUANTILES`."""
    metric_counts: Mapping[str, Distribution]
    """By the name of a field of `Metrics`, in the order shown."""
    cvga_counts: npt.NDArray[Any]
    """(60, 60) people, as `glucoloop.metrics.control_variability.grid_counts` gives them."""
    time_in_range_pct: Mapping[str, float]
    """Mean over the people, for each of `RANGES`; see `ranges_pct`."""
    table: Mapping[str, float | str]
    """Headline numbers in the order shown; a name may end in its unit in parentheses, as in "Worst (mg/dl)"."""
    worst: Sequence[WorstPerson]
    """The worst first."""


@dataclass(frozen=True)
class TrialReport:
    """A trial of one or several controllers over one population.

    Raises
    ------
    ValueError
        If there is no controller, or controllers differ in what is told of them, or something is missing.
    """

    title: str
    setpoint_mg_dl: float
    people: int
    """Asked for."""
    unable: int
    """Of these, the people without a basal rate, who are in nothing else."""
    facts: Mapping[str, str]
    """What was tried, by a word: population, seed, days."""
    cases: Mapping[str, CaseReport]
    """By label, in the order shown."""
    lowest_glucose_mg_dl: float = LOWEST_GLUCOSE_MG_DL

    def __post_init__(self) -> None:
        """Refuse what cannot be shown."""
        if not self.cases:
            raise ValueError("the trial has no controller to show; give at least one")
        first_label, first = next(iter(self.cases.items()))
        for label, case in self.cases.items():
            _check(label, case)
            for name, of_case, of_first in (
                ("headline numbers", list(case.table), list(first.table)),
                ("distributions", list(case.metric_counts), list(first.metric_counts)),
            ):
                if of_case != of_first:
                    raise ValueError(
                        f"{label!r} has the {name} {of_case} but {first_label!r} has {of_first}; give the same for "
                        "all, in the same order"
                    )
            for metric, distribution in case.metric_counts.items():
                if not np.array_equal(distribution.edges, first.metric_counts[metric].edges):
                    raise ValueError(
                        f"{metric} of {label!r} and of {first_label!r} are counted between different edges; "
                        "use the same for all"
                    )

    @property
    def horizon_min(self) -> float:
        """Length of the longest run."""
        return max(float(case.bands_t_min[-1]) for case in self.cases.values())


def _check(label: str, case: CaseReport) -> None:
    for kind, quantiles, t_min in (
        ("glucose", case.glucose_quantiles, case.bands_t_min),
        ("insulin", case.insulin_quantiles, case.insulin_t_min),
    ):
        for quantile in QUANTILES:
            if quantile not in quantiles:
                raise ValueError(f"{label!r} lacks the quantile {quantile:g} of {kind}; give {_listed(QUANTILES)}")
            if np.shape(quantiles[quantile]) != np.shape(t_min):
                raise ValueError(
                    f"{label!r} has {np.size(quantiles[quantile])} values of the quantile {quantile:g} of {kind} at "
                    f"{np.size(t_min)} times; give one at each"
                )
    for metric, distribution in case.metric_counts.items():
        described(metric)
        if np.size(distribution.edges) != np.size(distribution.counts) + 1:
            raise ValueError(
                f"{metric} of {label!r} has {np.size(distribution.counts)} bins between "
                f"{np.size(distribution.edges)} edges; give one edge more than bins"
            )
    if set(case.time_in_range_pct) != set(RANGES):
        raise ValueError(f"{label!r} has times in {_listed(case.time_in_range_pct)}; give {_listed(RANGES)}")


def _listed(values: Any) -> str:
    return ", ".join(map(str, values))


def ranges_pct(
    *,
    time_below_54_pct: float,
    time_below_70_pct: float,
    time_70_180_pct: float,
    time_above_180_pct: float,
    time_above_250_pct: float,
) -> dict[str, float]:
    """Times in `RANGES`, from the metrics of these names, which include one another; they make 100."""
    times = (
        time_below_54_pct,
        time_below_70_pct - time_below_54_pct,
        time_70_180_pct,
        time_above_180_pct - time_above_250_pct,
        time_above_250_pct,
    )
    return dict(zip(RANGES, (max(0.0, time) for time in times), strict=True))
