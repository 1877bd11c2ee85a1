"""Every metric of a record once: the function that computes it, and its numbers with title, unit and definition.

A number that a loop has too, by the same name, is described by `metrics.metric`; here it is over the readings of a
record, or all points of a course, while that of a loop is over its grid of one minute.

References
----------
T. Battelino et al., "Continuous glucose monitoring and metrics for clinical trials: an international consensus
statement", Lancet Diabetes Endocrinol. 11(1), 42-57, 2023: mean with standard deviation, or median with quartiles of
people.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from glucoloop.metrics.metric import Result, result_named
from glucoloop.metrics.readings import distribution, episodes, excursions
from glucoloop.metrics.readings.series import Readings


@dataclass(frozen=True)
class RecordMeasure:
    """A metric of a record."""

    section: str
    """Heading of its rows in tables."""
    of: Callable[[Readings], Mapping[str, float]]
    results: tuple[Result, ...]


def _shared(name: str, summary: str) -> Result:
    """A number that a loop has too, with its definition for a record."""
    return replace(result_named(name), summary=summary)


def _share(name: str, where: str, more: str = "", exact: str = "") -> Result:
    return Result(name, f"Percentage of time {exact or where}{more}.", f"Time {where}", "%")


def _count(name: str, summary: str, title: str) -> Result:
    return Result(name, summary, title, digits=0)


def _episodes(kind: str, where: str) -> Result:
    summary = f"Episodes with glucose {where} mg/dl for 15 min or longer, which end after 15 min that are not."
    return _count(f"{kind}_events", summary, f"Episodes {where} mg/dl")


MEASURES: Final = (
    RecordMeasure(
        "Sufficiency",
        distribution.sufficiency,
        (
            Result("days", "Days from the first reading to the last.", "Days", "d"),
            _count("readings", "Number of readings.", "Readings"),
            Result(
                "active_pct",
                "Time that the readings stand for, in percent of that from the first to the last.",
                "Time active",
                "%",
            ),
        ),
    ),
    RecordMeasure(
        "Glycemia",
        distribution.mean_and_variation,
        (
            _shared("mean_mg_dl", "Mean over the time that the readings stand for."),
            Result("sd_mg_dl", "Standard deviation (n - 1).", "Standard deviation", "mg/dl"),
            _shared("cv_pct", "Standard deviation (n - 1) in percent of the mean."),
            _shared("gmi_pct", "Glucose management indicator, 3.31 + 0.02392 mean."),
        ),
    ),
    RecordMeasure(
        "Times in ranges",
        distribution.times_in_ranges,
        (
            _share("time_above_250_pct", "above 250 mg/dl"),
            _share("time_180_250_pct", "from 181 to 250 mg/dl", exact="above 180 up to 250 mg/dl"),
            _share("time_above_180_pct", "above 180 mg/dl"),
            _share("time_70_180_pct", "from 70 to 180 mg/dl", ", both included"),
            _share("time_below_70_pct", "below 70 mg/dl"),
            _share("time_54_70_pct", "from 54 to 69 mg/dl", exact="of 54 or more and below 70 mg/dl"),
            _share("time_below_54_pct", "below 54 mg/dl"),
            _share("time_70_140_pct", "from 70 to 140 mg/dl", ", both included: the tight range"),
            _share("time_above_140_pct", "above 140 mg/dl"),
            _share("time_63_140_pct", "from 63 to 140 mg/dl", ", both included: the range of pregnancy"),
            _share("time_below_63_pct", "below 63 mg/dl"),
            _share("time_54_63_pct", "from 54 to 62 mg/dl", exact="of 54 or more and below 63 mg/dl"),
        ),
    ),
    RecordMeasure(
        "Risk",
        distribution.glycemia_risk,
        (
            _shared("gri", "Glycemia risk index."),
            Result("gri_hypo_pct", "Its component of low glucose.", "  component of low glucose", "%"),
            Result("gri_hyper_pct", "Its component of high glucose.", "  component of high glucose", "%"),
        ),
    ),
    RecordMeasure(
        "Risk",
        distribution.risk_indices,
        (
            _shared("lbgi", "Low blood glucose index."),
            _shared("hbgi", "High blood glucose index."),
            Result("bgri", "Blood glucose risk index: the sum of both.", "Blood glucose risk index", digits=2),
            Result("adrr", "Average daily risk range.", "Average daily risk range"),
        ),
    ),
    RecordMeasure(
        "Episodes",
        episodes.episode_counts,
        (
            _episodes("very_low", "below 54"),
            _episodes("low", "below 70"),
            _count("extended_low_events", "Those below 70 mg/dl for more than 120 min.", "  longer than 120 min"),
            _count("nocturnal_low_events", "Those below 70 mg/dl that began from 0 to 6 h.", "  begun from 0 to 6 h"),
            _episodes("high", "above 180"),
            _episodes("very_high", "above 250"),
        ),
    ),
    RecordMeasure(
        "Variability",
        excursions.amplitude,
        (
            Result(
                "mage_mg_dl",
                "Mean amplitude of rises and falls by more than one standard deviation.",
                "Mean amplitude of glycemic excursions (MAGE)",
                "mg/dl",
            ),
        ),
    ),
    RecordMeasure(
        "Variability",
        excursions.lagged_differences,
        (
            Result("modd_mg_dl", "Mean difference from 24 h earlier.", "Mean of daily differences (MODD)", "mg/dl"),
            Result("conga_1h_mg_dl", "Standard deviation of differences from 1 h earlier.", "CONGA over 1 h", "mg/dl"),
            Result(
                "conga_24h_mg_dl", "Standard deviation of differences from 24 h earlier.", "CONGA over 24 h", "mg/dl"
            ),
            Result("mag_mg_dl_h", "Mean absolute change in an hour.", "Mean absolute change (MAG)", "mg/dl per h"),
        ),
    ),
    RecordMeasure(
        "Quality",
        distribution.quality,
        (
            Result("grade", "Glycemic risk assessment diabetes equation.", "GRADE", digits=2),
            Result("grade_hypo_pct", "Its share below 70 mg/dl.", "  share below 70 mg/dl", "%"),
            Result("grade_eu_pct", "Its share from 70 to 140 mg/dl.", "  share from 70 to 140 mg/dl", "%"),
            Result("grade_hyper_pct", "Its share above 140 mg/dl.", "  share above 140 mg/dl", "%"),
            Result("j_index", "J-index, 0.001 (mean + SD)^2.", "J-index", digits=2),
            Result("m_value", "M-value with 90 mg/dl.", "M-value", digits=2),
        ),
    ),
)


def numbers_of(readings: Readings) -> dict[str, float]:
    """All metrics of a record or a course by name, NaN where one cannot be computed.

    Examples
    --------
    >>> from glucoloop.metrics.readings.series import Readings
    >>> numbers = numbers_of(Readings.of([0.0, 5.0, 10.0, 15.0], [60.0, 70.0, 180.0, 190.0]))
    >>> numbers["time_70_180_pct"], numbers["mean_mg_dl"]
    (50.0, 125.0)
    """
    results = {}
    for measure in MEASURES:
        values = measure.of(readings)
        results.update({result.name: values[result.name] for result in measure.results})
    return results


class PeopleSpread(NamedTuple):
    """One number over people; NaN where nobody has it."""

    people: int
    """Number of people who have it."""
    mean: float
    sd: float
    """Standard deviation with ``n - 1`` as its denominator; NaN for one person."""
    least: float
    p25: float
    median: float
    p75: float
    greatest: float


def _spread_of(values: Sequence[float]) -> PeopleSpread:
    """Spread of a number; a person for whom it is not finite is left out.

    Examples
    --------
    >>> _spread_of([1.0, 2.0, 3.0, float("nan")]).median
    2.0
    """
    given = np.asarray(values, float)
    given = given[np.isfinite(given)]
    if not given.size:
        return PeopleSpread(0, *[np.nan] * 7)
    quartiles = map(float, np.percentile(given, [0, 25, 50, 75, 100]))
    return PeopleSpread(
        given.size, float(given.mean()), float(given.std(ddof=1)) if given.size > 1 else np.nan, *quartiles
    )


def over_people(numbers: Sequence[Mapping[str, float]]) -> dict[str, PeopleSpread]:
    """Spread of each number over people; all have the same numbers."""
    return {name: _spread_of([of[name] for of in numbers]) for name in numbers[0]}
