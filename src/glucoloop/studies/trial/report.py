"""Content of a page or figure of a trial: plain numbers, and differences between its cases."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.display_units import OTHERS, in_shown_units, other_value
from glucoloop.metrics import LOWEST_GLUCOSE_MG_DL
from glucoloop.metrics.metric import result_named
from glucoloop.physiology.exercise import Exercise
from glucoloop.reporting.columns import MetricRow
from glucoloop.reporting.template import Repeat
from glucoloop.storage.results import Results
from glucoloop.studies.trial import TrialRequest
from glucoloop.text import NOT_AVAILABLE, how_many
from glucoloop.trials.statistics import Margin, people_for

Floats = npt.NDArray[np.float64]

RANGES: Final = {
    "below 54": ("time_below_54_pct",),
    "54 to 70": ("time_below_70_pct", "time_below_54_pct"),
    "70 to 180": ("time_70_180_pct",),
    "180 to 250": ("time_above_180_pct", "time_above_250_pct"),
    "above 250": ("time_above_250_pct",),
}
"""Ranges of glucose [mg/dl] over which the time is distributed: the metric of each, less the one that it includes."""


@dataclass(frozen=True)
class MetricDistribution:
    """Distribution of a metric over the people."""

    edges: Floats
    """(bins + 1,) edges in the metric's own unit; the same for every controller."""
    counts: npt.NDArray[Any]
    """(bins,) numbers of people; those beyond the edges are counted in the outermost bins."""
    p5: float
    """The metric that 5 % of the people stay below."""
    median: float
    p95: float

    @property
    def people(self) -> int:
        """Number of people."""
        return int(np.sum(self.counts))


@dataclass(frozen=True)
class WorstPerson:
    """One of the people with the worst outcomes, with glucose and insulin."""

    person: int
    """Number of the person in the population."""
    minimum_mg_dl: float
    """Minimum glucose of the person."""
    t_min: Floats
    """(points,) times of the person's glucose."""
    glucose_mg_dl: Floats
    """(points,) glucose free of noise."""
    insulin_t_min: Floats
    """(samples,) times from which each rate was delivered."""
    insulin_mU_min: Floats
    """(samples,) delivered rates."""
    note: str = ""
    """Differences of the person from the others, in words."""


@dataclass(frozen=True)
class CaseReport:
    """Results of one controller."""

    bands_t_min: Floats
    """(samples + 1,) times of the samples and of the horizon."""
    glucose_quantiles: Mapping[float, Floats]
    """(samples + 1,) quantiles of glucose [mg/dl] over the people: 0.01, 0.05, 0.25, 0.5, 0.75, 0.95 and 0.99."""
    insulin_t_min: Floats
    """(samples,) times from which each rate was delivered."""
    insulin_quantiles: Mapping[float, Floats]
    """(samples,) the same quantiles of delivered insulin [mU/min]."""
    metric_counts: Mapping[str, MetricDistribution]
    """Distributions by the name of a metric, in the order shown."""
    cvga_counts: npt.NDArray[Any]
    """(60, 60) numbers of people, as `glucoloop.metrics.control_variability.grid_counts` gives them."""
    time_in_range_pct: Mapping[str, float]
    """Mean time over the people in each of `RANGES`; see `ranges_pct`."""
    table: Mapping[tuple[str, str], float | str]
    """Headline numbers by name and unit, in the order shown."""
    worst: Sequence[WorstPerson]
    """People with the worst outcomes, the worst first."""
    ever_below: Mapping[int, tuple[int, float]] = field(default_factory=dict)
    """Number of people, and their share in percent, who were ever below a glucose, by that glucose [mg/dl]."""
    not_finite: int = 0
    """Number of people whose glucose or insulin did not stay finite; they are in none of the other numbers."""
    weeks: Sequence[Mapping[str, float]] = ()
    """Glucose of each week of a long run, all samples of all people together: quantiles p5 to p95, and shares of the
    time in ranges by the names of the metrics; bands are then of one day, all days together."""


@dataclass(frozen=True)
class TrialReport:
    """A trial of one or several controllers over one population; each has the same quantiles, metrics and bins."""

    title: str
    setpoint_mg_dl: float
    people: int
    """Number of people asked for."""
    infeasible: int
    """Number of people without a basal rate, who are in none of the other numbers."""
    facts: Mapping[str, str]
    """Settings of the trial by name: population, seed, days."""
    cases: Mapping[str, CaseReport]
    """Results by label, in the order shown."""
    lowest_glucose_mg_dl: float = LOWEST_GLUCOSE_MG_DL
    subcutaneous: bool = False
    """Whether insulin is subcutaneous: figures for print then have U/h, the target range, and the clock for days."""
    meals: Sequence[tuple[float, float]] = ()
    """Planned time in min and carbohydrate in g of each meal."""
    exercise: Sequence[Exercise] = ()
    """Planned bouts of exercise."""
    faults: Sequence[str] = ()
    """Faults of sensor and pump under every controller."""
    length_min: float = 0.0
    """Length of the run, where weeks are shown."""
    start_min: float = 0.0
    """Time of day at the start, after midnight."""
    reference: str = ""
    """Controller from which the differences are."""
    differences: Sequence[MetricRow] = ()
    """Paired differences of the other controllers from it, with intervals of 95 %."""
    conclusions: Sequence[str] = ()
    """Conclusions on the margins that were asked for."""
    repeat: Repeat | None = None
    """Command and configuration that repeat the trial."""

    @property
    def horizon_min(self) -> float:
        """Length of the longest run."""
        return max(float(case.bands_t_min[-1]) for case in self.cases.values())


def ranges_pct(time_pct: Callable[[str], float]) -> dict[str, float]:
    """Times in `RANGES` from those of the metrics, which include one another; they add up to 100."""
    parts = {name: list(map(time_pct, names)) for name, names in RANGES.items()}
    return {name: max(0.0, whole - sum(included)) for name, (whole, *included) in parts.items()}


_COMPARED: Final = (
    *("time_70_180_pct", "time_above_180_pct", "time_above_250_pct", "time_below_70_pct", "time_below_54_pct"),
    *("mean_mg_dl", "minimum_mg_dl", "insulin_total_mU"),
)
"""Metrics whose differences are shown."""
_EVER_BELOW: Final = ("70", "54")
_VERDICTS: Final = {
    "equivalent": "equivalent, since the 95 % interval of the difference lies within ±{margin}",
    "higher": "higher by more than {margin} under {label}",
    "lower": "lower by more than {margin} under {label}",
    "inconclusive": "open, since the 95 % interval of the difference lies neither within ±{margin} nor beyond it",
}
"""Conclusions by the names of `intervals.Margin.verdict`."""


def difference_rows(trial: TrialRequest, plain: Mapping[str, Any]) -> Iterator[MetricRow]:
    """Difference of each controller from the first one in each metric, mean with its interval."""
    cases = plain["differences"]["controllers"].values()
    for metric in dict.fromkeys((*_COMPARED, *trial.margins)):
        how = result_named(metric, trial.further_metrics)
        values = [case["metrics"][metric] for case in cases]

        def own(value: float, divisor: float = how.divisor, digits: int = how.digits) -> str:
            return f"{value / divisor:+z.{digits}f}"

        def other(value: float, unit: str = how.unit, divisor: float = how.divisor, digits: int = how.digits) -> str:
            return f"{other_value(value / divisor, unit):+z.{digits + 1}f}"

        others = [_with_interval(of, other) for of in values] if how.unit in OTHERS else None
        texts = [_with_interval(of, own) for of in values]
        yield MetricRow("", how.title or metric, _unit(how.unit), texts, others)
    for limit in _EVER_BELOW:
        shares = [_with_interval(case["ever_below"][f"{limit}_mg_dl"], "{:+z.1f}".format) for case in cases]
        yield MetricRow("", f"People ever below {limit} mg/dl", "points", shares)


def margin_conclusions(trial: TrialRequest, differences: Mapping[str, Any]) -> dict[str, Any]:
    """Conclusion on each margin as plain values, by metric and controller."""
    return {
        metric: {
            label: {
                "margin": margin,
                "verdict": Margin(metric, margin).verdict(of["metrics"][metric]),
                "people_for_margin": people_for(margin, of["metrics"][metric]["sd"]),
            }
            for label, of in differences["controllers"].items()
        }
        for metric, margin in trial.margins.items()
    }


def sentences(config: TrialRequest, results: Results) -> Iterator[str]:
    """Conclusions on the margins, with the number of people that such a precision takes."""
    differences = results.plain.get("differences", {})
    for metric, by_label in differences.get("margins", {}).items():
        how = result_named(metric, config.further_metrics)
        for label, of in by_label.items():
            margin = in_shown_units(f"{of['margin'] / how.divisor:g} {_unit(how.unit)}".strip())
            conclusion = _VERDICTS[of["verdict"]].format(margin=margin, label=label)
            people = of["people_for_margin"]
            needed = (
                ""
                if people is None
                else (f" An interval of that half width takes {how_many(people, 'person', 'people')}.")
            )
            yield f"{how.title or metric}, {label} against {differences['reference']}: {conclusion}.{needed}"


def _unit(unit: str) -> str:
    """Unit of a difference; percentages differ by points."""
    return "points" if unit == "%" else unit


def _with_interval(difference: Mapping[str, float | None], text: Callable[[float], str]) -> str:
    """Mean difference with its interval, as ``+1.2 [+0.8, +1.6]``."""
    mean, low, high = (difference[name] for name in ("mean", "low", "high"))
    if mean is None or not math.isfinite(mean):
        return NOT_AVAILABLE
    if low is None or high is None or not math.isfinite(low):
        return f"{text(mean)} [n/a]"
    return f"{text(mean)} [{text(low)}, {text(high)}]"
