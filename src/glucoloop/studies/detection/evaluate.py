"""Evaluation of estimators: days are simulated, estimators replayed over them, and scored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.meals import Eaten, absorb, emptying_mg_min, meal_model_of
from glucoloop.patients.population import virtual_people
from glucoloop.refusal import Refusal
from glucoloop.studies.detection.days import (
    DayLoop,
    Days,
    Estimator,
    day_grid,
    in_even_blocks,
    who_and_when,
)
from glucoloop.studies.detection.detection import Detection
from glucoloop.studies.detection.result import (
    QUANTILES,
    TOLD_AFTER_MIN,
    Curve,
    DetectionResult,
    EstimatorResult,
    ExampleDay,
    MealTable,
    SizeError,
)
from glucoloop.studies.detection.scores import (
    AFTERMATH_MIN,
    days_of,
    delays_min,
    end_min,
    false_alarms,
    followed_min,
    told_at,
    under_way,
)

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]

THRESHOLDS: Final = (*(round(0.05 * k, 2) for k in range(1, 20)), 0.98, 0.99, 0.995)
LONGEST_AFTER_MIN: Final = 240.0


@dataclass(frozen=True)
class Estimated:
    """Days with the estimates along them; days trail."""

    days: Days
    eating: Array
    """(samples, days) probability that a meal is being served."""
    carbs_g: Array
    remaining_g: Array
    emptying_mg_min: Array


def evaluate(detection: Detection, progress: Progress | None = None) -> DetectionResult:
    """Try estimators on days with and without meals.

    Parameters
    ----------
    detection : Detection
    progress : callable, optional
        Called with a short description of each finished step.

    Raises
    ------
    ValueError
        For a design that is not possible, or if no basal rate holds any of the people at the setpoint.
    """
    tell = progress or (lambda what: None)
    person, day, infeasible = who_and_when(detection)
    if not person.size:
        setpoint = detection.trial.target_mg_dl
        raise Refusal(
            f"no basal rate holds any of the {detection.trial.people} people at {setpoint:g} mg/dl; "
            "give more people or another setpoint"
        )
    recorded: dict[str, tuple[list[Days], list[Days]]] = {}
    results = []
    blocks, size = in_even_blocks(person.size)
    for name in detection.estimators:
        label = detection.case(name)
        if label not in recorded:
            loop = DayLoop(detection, label)
            recorded[label] = [], []
            for fasting in (False, True):
                if not fasting and not detection.trial.plan.meals:
                    continue  # they would be fasting days too
                for block in range(blocks):
                    here = slice(block * size, (block + 1) * size)
                    recorded[label][fasting].append(loop.run(person[here], day[here], fasting=fasting, size=size))
                    tell(f"{label}: {block + 1} of {blocks} blocks of {'fasting days' if fasting else 'days'}")
        estimator = Estimator(detection, name)
        fed, fasted = (
            None if not parts else _joined([_estimated(estimator, days, size) for days in parts])
            for parts in recorded[label]
        )
        if fasted is None:
            raise TypeError("fasting days are always simulated")
        tell(f"{name}: estimates")
        controller = next(case.controller for case in detection.trial.cases if case.label == label)
        results.append(score(detection, name, controller, fed, fasted))
    return DetectionResult(estimators=tuple(results), days=person.size, infeasible=infeasible)


def _estimated(estimator: Estimator, days: Days, size: int) -> Estimated:
    told = estimator.over(days, size=size)
    return Estimated(
        days=days,
        eating=np.asarray(told.eating),
        carbs_g=np.asarray(told.carbs_g),
        remaining_g=np.asarray(told.remaining_g),
        emptying_mg_min=np.asarray(told.emptying_mg_min),
    )


def _joined(parts: list[Estimated]) -> Estimated:
    """Days of blocks side by side."""

    def beside(*values: Array) -> Array:
        return np.concatenate(values, axis=-1)

    def fields(of: Any) -> dict[str, Any]:
        return dict(vars(of))

    together = jax.tree.map(beside, *(fields(part.days) for part in parts))
    own = jax.tree.map(beside, *({k: v for k, v in fields(part).items() if k != "days"} for part in parts))
    return Estimated(days=Days(**together), **own)


def score(
    detection: Detection, name: str, controller: str, fed: Estimated | None, fasted: Estimated
) -> EstimatorResult:
    """Score of an estimator.

    Parameters
    ----------
    detection : Detection
    name, controller : str
        Name of the estimator, and of the controller that dosed.
    fed : Estimated, optional
        Days with meals; None without any.
    fasted : Estimated
        Days without a meal.
    """
    grid = day_grid(detection)
    t_min, horizon = grid.t_min, detection.trial.plan.horizon_min
    thresholds = np.unique([*THRESHOLDS, detection.threshold])
    nothing = np.zeros((t_min.size, 0))
    none = np.zeros((0, 0))
    meals = Eaten(t_min=none, carbs_g=none, eating_min=none) if fed is None else fed.days.meals
    eating = nothing if fed is None else fed.eating
    quiet = np.zeros(nothing.shape, bool) if fed is None else ~under_way(meals, t_min)
    fasting_days = days_of(np.ones(fasted.eating.shape, bool), grid.sample_time_min)
    between_days = days_of(quiet, grid.sample_time_min)
    return EstimatorResult(
        estimator=name,
        controller=controller,
        threshold=detection.threshold,
        meals=_meal_table(fed, t_min, detection.threshold, horizon),
        curve=_curve(thresholds, eating, meals, quiet, fasted.eating, t_min, horizon, fasting_days, between_days),
        size_error=_size_error(fed, t_min, detection.threshold, horizon, grid.sample_time_min),
        fasting_days=fasting_days,
        between_days=between_days,
        example=_example(detection, fasted if fed is None else fed, t_min),
    )


def _curve(
    thresholds: Array,
    eating: Array,
    meals: Eaten,
    quiet: npt.NDArray[np.bool_],
    fasted: Array,
    t_min: Array,
    horizon_min: float,
    fasting_days: float,
    between_days: float,
) -> Curve:
    rows = []
    always = np.ones(fasted.shape, bool)
    for threshold in thresholds.tolist():
        delay, already = delays_min(eating, t_min, meals, threshold, horizon_min)
        known = delay[np.isfinite(delay)]
        number = max(1, delay.size)
        rows.append(
            [
                threshold,
                np.median(known) if known.size else np.nan,
                np.quantile(known, QUANTILES[-1]) if known.size else np.nan,
                100.0 * (~np.isfinite(delay) & ~already).sum() / number if delay.size else np.nan,
                100.0 * already.sum() / number if delay.size else np.nan,
                false_alarms(fasted, always, threshold) / fasting_days,
                false_alarms(eating, quiet, threshold) / between_days if between_days else np.nan,
            ]
        )
    return Curve(*np.array(rows, float).T)


def _meal_table(fed: Estimated | None, t_min: Array, threshold: float, horizon_min: float) -> MealTable:
    if fed is None:
        none = np.zeros(0)
        numbers = np.zeros(0, np.int64)
        return MealTable(
            numbers, numbers, none, none, none, np.zeros(0, bool), none, dict.fromkeys(TOLD_AFTER_MIN, none)
        )
    meals, begin_min = fed.days.meals, np.asarray(fed.days.meals.t_min)
    delay, already = delays_min(fed.eating, t_min, meals, threshold, horizon_min)
    since, over = begin_min + delay, followed_min(meals, horizon_min)
    expected = fed.carbs_g + fed.remaining_g

    def row(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Values of all meals, day by day."""
        return np.broadcast_to(values, begin_min.shape).T.ravel()

    return MealTable(
        person=row(fed.days.person),
        day=row(fed.days.day),
        t_min=row(begin_min),
        carbs_g=row(np.asarray(meals.carbs_g)),
        delay_min=row(delay),
        already=row(already),
        estimated_g=row(told_at(fed.carbs_g, t_min, end_min(meals) + AFTERMATH_MIN, since, over)),
        expected_g={after: row(told_at(expected, t_min, begin_min + after, since, over)) for after in TOLD_AFTER_MIN},
    )


def _size_error(
    fed: Estimated | None, t_min: Array, threshold: float, horizon_min: float, sample_time_min: float
) -> SizeError:
    after: Array = sample_time_min * np.arange(int(LONGEST_AFTER_MIN / sample_time_min) + 1, dtype=np.float64)
    if fed is None:
        return SizeError(after, np.full((len(QUANTILES), after.size), np.nan), np.zeros(after.size, np.int64))
    meals, expected = fed.days.meals, fed.carbs_g + fed.remaining_g
    begin_min, carbs_g = np.asarray(meals.t_min), np.asarray(meals.carbs_g)
    delay, _ = delays_min(fed.eating, t_min, meals, threshold, horizon_min)
    since, over = begin_min + delay, followed_min(meals, horizon_min)
    error = [(told_at(expected, t_min, begin_min + lag, since, over) - carbs_g).ravel() for lag in after.tolist()]
    known = [of[np.isfinite(of)] for of in error]
    return SizeError(
        after_min=after,
        error_g=np.array([np.quantile(of, QUANTILES) if of.size else [np.nan] * len(QUANTILES) for of in known]).T,
        meals=np.array([of.size for of in known], np.int64),
    )


def _example(detection: Detection, estimated: Estimated, t_min: Array) -> ExampleDay:
    days, trial = estimated.days, detection.trial
    eats = virtual_people(trial.population, trial.seed, days.person[:1], setpoint_mg_dl=trial.target_mg_dl).patient
    meals = absorb(meal_model_of(eats, trial.gut), jax.tree.map(lambda part: part[:, :1], days.meals))
    return ExampleDay(
        t_min=t_min,
        glucose_mg_dl=days.glucose_mg_dl[:, 0],
        reading_mg_dl=days.reading_mg_dl[:, 0],
        insulin_mU_min=days.insulin_mU_min[:, 0],
        eating=estimated.eating[:, 0],
        emptying_mg_min=np.asarray(jax.vmap(lambda t: emptying_mg_min(t, meals))(t_min))[:, 0],
        estimated_emptying_mg_min=estimated.emptying_mg_min[:, 0],
        carbs_g=estimated.carbs_g[:, 0],
        remaining_g=estimated.remaining_g[:, 0],
    )
