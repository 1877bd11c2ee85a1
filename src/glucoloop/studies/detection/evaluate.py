"""Evaluation of estimators: days are simulated, estimators replayed over them, and scored.

Scores are by a threshold on the probability that a meal is being served. A meal counts as *under way* from its
beginning to 60 min after its end: a probability above the threshold in that time is not a false alarm, and a rise above
it later does not count as its detection. Times are on the leading axis, days trail.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import jax
import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.meals import Eaten, absorb, emptying_mg_min, meal_model_of
from glucoloop.meals.stomach import SERVED_G_PER_MIN
from glucoloop.refusal import Refusal
from glucoloop.studies.detection import Detection
from glucoloop.studies.detection.days import Days, people_of, recorded_days, who_and_when, with_estimates
from glucoloop.units import MIN_PER_DAY

Array = npt.NDArray[np.float64]
Truths = npt.NDArray[np.bool_]

AFTERMATH_MIN: Final = 60.0
"""Time after a meal's end for which it is still under way, and after which its size is judged."""
THRESHOLDS: Final = (*(round(0.05 * k, 2) for k in range(1, 20)), 0.98, 0.99, 0.995)
QUANTILES: Final = (0.1, 0.5, 0.9)
JUDGED_AFTER_MIN: Final = (30, 60, 90, 120)
"""Times after a meal's beginning at which its expected size is judged."""
LONGEST_AFTER_MIN: Final = 240.0


class Score(NamedTuple):
    """Score of an estimator."""

    tables: dict[str, pl.DataFrame]
    """Tables by the names of their files, in which a number that is not known is null: each meal (its estimates are
    null if it was not detected by then, another one had begun or the day was over), each threshold, the error of the
    size over time, and the first day of the first person."""
    alarms: dict[str, float | None]
    """False alarms at the threshold that was asked for, and the time in which they could happen."""


class Scores(NamedTuple):
    """Scores of all estimators, on as many days with meals as without; people without a basal rate are left out."""

    of: dict[str, Score]
    days: int
    infeasible: int


def evaluate(detection: Detection, progress: Callable[[str], None]) -> Scores:
    """Try estimators on days with and without meals.

    `progress` is called with a short description of each finished step. Refusal for a design that is not possible, or
    if no basal rate holds any of the people at the setpoint.
    """
    person, day, infeasible = who_and_when(detection)
    if not person.size:
        raise Refusal(
            f"no basal rate holds any of the {detection.trial.people} people at {detection.trial.target_mg_dl:g} "
            "mg/dl; give more people or another setpoint"
        )
    recorded: dict[str, dict[bool, Days]] = {}
    cases = {case.label: case for case in detection.trial.cases}
    scores = {}
    for name in detection.estimators:
        case = cases.get(name, detection.trial.cases[0])
        if case.label not in recorded:
            recorded[case.label] = recorded_days(detection, case, person, day, progress)
        days = with_estimates(detection, name, recorded[case.label], progress)
        scores[name] = score(detection, days.get(False), days[True])
    return Scores(scores, person.size, infeasible)


def score(detection: Detection, fed: Days | None, fasted: Days) -> Score:
    """Score of an estimator on days with meals, if there are any, and on as many without."""
    day = _day(detection, fasted if fed is None else fed)
    fed = jax.tree.map(lambda part: part[..., :0], fasted) if fed is None else fed
    grid, meals, eating = detection.grid, fed.meals, fed.estimates.eating
    quiet, always = ~under_way(meals, grid.t_min), np.ones(fasted.estimates.eating.shape, bool)
    fasting_days, between_days = (days_of(of, grid.sample_time_min) for of in (always, quiet))
    rows = {}
    for threshold in np.unique([*THRESHOLDS, detection.threshold]).tolist():
        delay, already = delays_min(eating, grid.t_min, meals, threshold, detection.trial.plan.horizon_min)
        found = np.isfinite(delay)
        between = false_alarms(eating, quiet, threshold)
        rows[threshold] = {
            "threshold": threshold,
            "delay_median_min": np.median(delay[found]) if found.any() else None,
            "delay_p90_min": np.quantile(delay[found], QUANTILES[-1]) if found.any() else None,
            "missed_pct": 100.0 * (~found & ~already).sum() / delay.size if delay.size else None,
            "already_pct": 100.0 * already.sum() / delay.size if delay.size else None,
            "false_alarms_fasting_per_day": false_alarms(fasted.estimates.eating, always, threshold) / fasting_days,
            "false_alarms_between_per_day": between / between_days if between_days else None,
        }
    at = rows[detection.threshold]
    alarms = {
        "false_alarms_fasting_per_day": at["false_alarms_fasting_per_day"],
        "fasting_days": fasting_days,
        "false_alarms_between_per_day": at["false_alarms_between_per_day"],
        "between_days": between_days,
    }
    curve = pl.DataFrame(list(rows.values()), schema=dict.fromkeys(at, pl.Float64))
    tables = {"curve": curve, **_of_meals(detection, fed), "day": day}
    return Score(
        {name: table.with_columns(pl.col(pl.Float64).fill_nan(None)) for name, table in tables.items()}, alarms
    )


def _of_meals(detection: Detection, fed: Days) -> dict[str, pl.DataFrame]:
    """Each meal, and the error of the size over time."""
    grid, estimates, horizon_min = detection.grid, fed.estimates, detection.trial.plan.horizon_min
    begin_min: Any = fed.meals.t_min
    carbs_g: Any = fed.meals.carbs_g
    delay, already = delays_min(estimates.eating, grid.t_min, fed.meals, detection.threshold, horizon_min)
    over = followed_min(fed.meals, horizon_min)

    def estimate(values: Any, at_min: Array) -> Array:
        return estimate_at(values, grid.t_min, at_min, begin_min + delay, over)

    def expected(after_min: float) -> Array:
        return estimate(estimates.carbs_g + estimates.remaining_g, begin_min + after_min)

    columns: dict[str, Any] = {
        "person": fed.person,
        "day": fed.day,
        "t_min": begin_min,
        "carbs_g": carbs_g,
        "delay_min": delay,
        "already": already,
        "missed": ~np.isfinite(delay) & ~already,
        "estimated_g": estimate(estimates.carbs_g, end_min(fed.meals) + AFTERMATH_MIN),
        **{f"expected_{after}_min_g": expected(after) for after in JUDGED_AFTER_MIN},
    }
    # day by day
    meals = pl.DataFrame({name: np.broadcast_to(of, begin_min.shape).T.ravel() for name, of in columns.items()})
    rows = []
    for after in (grid.sample_time_min * np.arange(int(LONGEST_AFTER_MIN / grid.sample_time_min) + 1)).tolist():
        error = (expected(after) - carbs_g).ravel()
        known = error[np.isfinite(error)]
        quantiles = np.quantile(known, QUANTILES) if known.size else np.full(len(QUANTILES), np.nan)
        errors = {f"error_p{100 * share:.0f}_g": of for share, of in zip(QUANTILES, quantiles, strict=True)}
        rows.append({"after_min": after, **errors, "meals": known.size})
    return {"meals": meals, "size_error": pl.DataFrame(rows)}


def _day(detection: Detection, days: Days) -> pl.DataFrame:
    """The first day of the first person."""
    trial, t_min = detection.trial, detection.grid.t_min
    eats = meal_model_of(people_of(trial, days.person[:1]).patient, trial.gut)
    meals = absorb(eats, jax.tree.map(lambda part: part[:, :1], days.meals))
    first: Days = jax.tree.map(lambda part: part[..., 0], days)
    return pl.DataFrame(
        {
            "t_min": t_min,
            "glucose_mg_dl": first.glucose_mg_dl,
            "reading_mg_dl": first.reading_mg_dl,
            "insulin_mU_min": first.insulin_mU_min,
            "eating": first.estimates.eating,
            "emptying_mg_min": np.asarray(jax.vmap(lambda t: emptying_mg_min(t, meals))(t_min))[:, 0],
            "estimated_emptying_mg_min": first.estimates.emptying_mg_min,
            "carbs_g": first.estimates.carbs_g,
            "remaining_g": first.estimates.remaining_g,
        }
    )


def end_min(meals: Eaten) -> Array:
    """Time at which each meal has been served, ``(meals, days)``."""
    return np.asarray(meals.t_min + np.maximum(meals.carbs_g / SERVED_G_PER_MIN, meals.eating_min))


def followed_min(meals: Eaten, horizon_min: float) -> Array:
    """Time at which each meal's period ends, by the next meal or the end of the day, ``(meals, days)``."""
    after = np.full((1, meals.t_min.shape[1]), horizon_min)
    followed: Array = np.minimum(np.concatenate([meals.t_min[1:], after]), horizon_min)
    return followed


def under_way(meals: Eaten, t_min: Array) -> Truths:
    """Whether a meal is being served, or was within the last 60 min, ``(samples, days)``."""
    t = t_min[:, None, None]
    way: Truths = np.any((meals.t_min <= t) & (t <= end_min(meals) + AFTERMATH_MIN), axis=1)
    return way


def delays_min(eating: Array, t_min: Array, meals: Eaten, threshold: float, horizon_min: float) -> tuple[Array, Truths]:
    """Delay of the first sample after each meal's beginning at which the probability is above the threshold.

    It is ``(meals, days)``, with NaN for a meal that was missed, or that began with the probability above the threshold
    already, which is told beside it. Meals of a day are in their order.
    """
    above = eating > threshold
    last = np.minimum(end_min(meals) + AFTERMATH_MIN, followed_min(meals, horizon_min))
    delay, already = np.full(meals.t_min.shape, np.nan), np.zeros(meals.t_min.shape, bool)
    for row, (begin, until) in enumerate(zip(meals.t_min, last, strict=True)):
        before = np.searchsorted(t_min, begin, side="right") - 1
        already[row] = above[before, np.arange(begin.size)]
        found = above & (t_min[:, None] > begin) & (t_min[:, None] <= until)
        first = t_min[np.argmax(found, axis=0)] - begin
        delay[row] = np.where(found.any(axis=0) & ~already[row], first, np.nan)
    return delay, already


def false_alarms(eating: Array, quiet: Truths, threshold: float) -> int:
    """Number of rises of the probability above the threshold that begin in a quiet time, ``(samples, days)``."""
    above = eating > threshold
    before = np.concatenate([np.zeros_like(above[:1]), above[:-1]])
    return int((above & ~before & quiet).sum())


def days_of(quiet: Truths, sample_time_min: float) -> float:
    """Length of the quiet time, in days."""
    return float(quiet.sum() * sample_time_min / MIN_PER_DAY)


def estimate_at(values: Array, t_min: Array, at_min: Array, since_min: Array, until_min: Array) -> Array:
    """Estimate for each meal at the first sample from a time on, all ``(meals, days)``.

    It is NaN where that sample is before the detection, until when an estimate is about the meal before, or not before
    the end of the meal's period.
    """
    sample = np.searchsorted(t_min, at_min, side="left")
    index = np.minimum(sample, t_min.size - 1)
    at_sample = np.take_along_axis(values, index, axis=0)
    counts = (sample < t_min.size) & (t_min[index] >= since_min) & (t_min[index] < until_min)
    return np.where(counts, at_sample, np.nan)
