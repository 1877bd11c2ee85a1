"""Evaluation of estimators: days are simulated, estimators replayed over them, and scored."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import jax
import numpy as np
import polars as pl

from glucoloop.meals import absorb, emptying_mg_min, meal_model_of
from glucoloop.refusal import Refusal
from glucoloop.studies.detection import Detection
from glucoloop.studies.detection.days import Days, people_of, recorded_days, who_and_when, with_estimates
from glucoloop.studies.detection.scores import (
    AFTERMATH_MIN,
    Array,
    days_of,
    delays_min,
    end_min,
    false_alarms,
    followed_min,
    told_at,
    under_way,
)

THRESHOLDS: Final = (*(round(0.05 * k, 2) for k in range(1, 20)), 0.98, 0.99, 0.995)
QUANTILES: Final = (0.1, 0.5, 0.9)
TOLD_AFTER_MIN: Final = (30, 60, 90, 120)
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
    grid, meals, eating = detection.grid, fed.meals, fed.told.eating
    quiet, always = ~under_way(meals, grid.t_min), np.ones(fasted.told.eating.shape, bool)
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
            "false_alarms_fasting_per_day": false_alarms(fasted.told.eating, always, threshold) / fasting_days,
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
    grid, told, horizon_min = detection.grid, fed.told, detection.trial.plan.horizon_min
    begin_min: Any = fed.meals.t_min
    carbs_g: Any = fed.meals.carbs_g
    delay, already = delays_min(told.eating, grid.t_min, fed.meals, detection.threshold, horizon_min)
    over = followed_min(fed.meals, horizon_min)

    def estimate(values: Any, at_min: Array) -> Array:
        return told_at(values, grid.t_min, at_min, begin_min + delay, over)

    def expected(after_min: float) -> Array:
        return estimate(told.carbs_g + told.remaining_g, begin_min + after_min)

    columns: dict[str, Any] = {
        "person": fed.person,
        "day": fed.day,
        "t_min": begin_min,
        "carbs_g": carbs_g,
        "delay_min": delay,
        "already": already,
        "missed": ~np.isfinite(delay) & ~already,
        "estimated_g": estimate(told.carbs_g, end_min(fed.meals) + AFTERMATH_MIN),
        **{f"expected_{after}_min_g": expected(after) for after in TOLD_AFTER_MIN},
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
            "eating": first.told.eating,
            "emptying_mg_min": np.asarray(jax.vmap(lambda t: emptying_mg_min(t, meals))(t_min))[:, 0],
            "estimated_emptying_mg_min": first.told.emptying_mg_min,
            "carbs_g": first.told.carbs_g,
            "remaining_g": first.told.remaining_g,
        }
    )
