"""Days of people under a controller, recorded as an estimator would see them, estimates along them, and their scores.

Scores are by a threshold on the probability that a meal is being served. A meal counts as *under way* from its
beginning to 60 min after its end: a probability above the threshold in that time is not a false alarm, and a rise above
it later does not count as its detection. Times are on the leading axis, days trail.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import typing
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop._pytree import pytree
from glucoloop.build.designs import controller_of
from glucoloop.build.random_keys import keys_of_people
from glucoloop.build.surroundings import surroundings_of
from glucoloop.component.request import Request
from glucoloop.estimation.unknown_meal.replay import MealEstimates, replay
from glucoloop.meals import Eaten, absorb, meal_model_of
from glucoloop.meals.plan import draw_meals
from glucoloop.meals.stomach import SERVED_G_PER_MIN
from glucoloop.refusal import Refusal
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.situations.case import Case, completed_case
from glucoloop.studies.detection import Detection
from glucoloop.trials.engine import fold_of, loop_of, people_of
from glucoloop.trials.people import in_blocks
from glucoloop.units import MIN_PER_DAY

T = TypeVar("T")
Array = npt.NDArray[Any]
Truths = npt.NDArray[np.bool_]
Numbers = npt.NDArray[np.int64]

ENGINE: Final = {"engine": "xla", "not_native": "the replay of estimators, which runs in JAX alone"}
"""Engine of the days and of the estimates, as `PeopleLoop.engine_facts` has it."""
_MAX_AT_ONCE: Final = 64
_AFTERMATH_MIN: Final = 60.0
"""Time after a meal's end for which it is still under way, and after which its size is judged."""
_THRESHOLDS: Final = (*(round(0.05 * k, 2) for k in range(1, 20)), 0.98, 0.99, 0.995)
QUANTILES: Final = (0.1, 0.5, 0.9)
JUDGED_AFTER_MIN: Final = (30, 60, 90, 120)
"""Times after a meal's beginning at which its expected size is judged."""
_LONGEST_AFTER_MIN: Final = 240.0


@pytree
class _Days:
    """Recorded days; days trail."""

    person: Numbers
    day: Numbers
    meals: Eaten
    basal_insulin_mU_min: Array
    reading_mg_dl: Array
    """(samples, days) readings, NaN where there was none."""
    insulin_mU_min: Array
    """(samples, days) rates as the pump reported them, from each sample to the next."""
    glucose_mg_dl: Array
    """(samples, days) glucose free of noise."""
    estimates: Any = None
    """`MealEstimates` along them, of an estimator."""


def _recorded_days(
    detection: Detection, case: Case, person: Numbers, day: Numbers, progress: Callable[[str], None]
) -> dict[bool, _Days]:
    """Days of people under a controller, by whether they are fasting days, which have noise of their own."""
    trial = detection.trial
    loop = loop_of(
        trial,
        controller_of(trial, case),
        fold_of(trial),
        meals=None,
        surroundings=surroundings_of(trial, case.faults),
        engine=ENGINE["engine"],
        record_decisions=True,
    )

    def block(fasting: bool, place: Numbers) -> _Days:
        whose, which = person[place], day[place]
        with one_at_a_time:
            people = people_of(trial, whose)
            meals = _meals(detection, whose, which, fasting=fasting)
            keys = jax.vmap(jax.random.fold_in)(keys_of_people(trial.seed, whose), jnp.asarray(2 * which + fasting))
        run = loop.run(people, keys, meals=meals)
        return _Days(
            person=whose,
            day=which,
            meals=meals,
            basal_insulin_mU_min=people.basal_insulin_mU_min,
            reading_mg_dl=np.asarray(run.reading_mg_dl),
            insulin_mU_min=np.asarray(run.reported_mU_min),
            glucose_mg_dl=run.glucose_mg_dl[:-1],
        )

    # without meals in the plan, days with meals would be fasting days too
    kinds = {False: "days", True: "fasting days"} if trial.plan.meals else {True: "fasting days"}
    return {
        fasting: _in_blocks(person.size, functools.partial(block, fasting), progress, f"{case.label}: {what}")
        for fasting, what in kinds.items()
    }


def _in_blocks(n: int, run: Callable[[Numbers], T], progress: Callable[[str], None], what: str) -> T:
    """Results at n places, which trail, in blocks as even as can be."""
    blocks, done = -(-n // _MAX_AT_ONCE), itertools.count(1)
    parts = in_blocks(
        lambda place, _: run(place),
        np.arange(n),
        -(-n // blocks),
        threads=1,
        done=lambda _: progress(f"{what}, {next(done)} of {blocks} blocks"),
    )
    together: T = jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1)[..., :n], *parts)
    return together


def _meals(detection: Detection, person: Numbers, day: Numbers, *, fasting: bool) -> Eaten:
    """Meals of days, ``(meals, days)``; a fasting day has as many of 0 g, so that it is the same program."""
    number = len(detection.all_days.meals)
    if fasting or not number:
        none = np.zeros((max(1, number), person.size))
        return Eaten(t_min=none, carbs_g=none, eating_min=none)
    planned = draw_meals(detection.all_days, detection.trial.seed, person)
    rows, columns = day * number + np.arange(number)[:, None], np.arange(person.size)
    of_day = jax.tree.map(lambda part: part[rows, columns], planned)
    return _in_order(dataclasses.replace(of_day, t_min=of_day.t_min - MIN_PER_DAY * day))


def _in_order(meals: Eaten) -> Eaten:
    """Meals of days ``(meals, days)``, sorted by their beginning within each day."""
    order = np.argsort(meals.t_min, axis=0, kind="stable")
    ordered: Eaten = jax.tree.map(lambda part: np.take_along_axis(np.asarray(part), order, 0), meals)
    return ordered


def _who_and_when(detection: Detection) -> tuple[Numbers, Numbers, int]:
    """Person and day of every run of people with a basal rate, and the number of people without one."""
    trial = detection.trial
    person = trial.first_person + np.arange(trial.people, dtype=np.int64)
    feasible = people_of(trial, person).feasible
    feasible_person = person[feasible]
    day = np.arange(detection.number_of_days, dtype=np.int64)
    return np.repeat(feasible_person, day.size), np.tile(day, feasible_person.size), int((~feasible).sum())


def _with_estimates(
    detection: Detection, name: str, recorded: Mapping[bool, _Days], progress: Callable[[str], None]
) -> dict[bool, _Days]:
    """Days with the estimates of an estimator, with the settings of the controller that uses it."""
    trial, t_min = detection.trial, jnp.asarray(detection.trial.grid.t_min)
    known, estimating = trial.cases[0].known_dead_time, detection.estimating
    controller = dataclasses.replace(typing.cast(Any, estimating), estimator=detection.tried[name])
    case = completed_case(Request(Case, {"label": name, "controller": controller, "known_dead_time": known}), trial)
    controller, late = controller_of(trial, case), trial.dead_time_samples if known else 0

    def estimated(days: _Days) -> _Days:
        basal, rates = days.basal_insulin_mU_min, _accepted_rates(days.insulin_mU_min, days.basal_insulin_mU_min)

        def block(place: Numbers) -> Any:
            of_block = (jnp.asarray(values[..., place]) for values in (basal, days.reading_mg_dl, rates))
            return _of_days(controller, t_min, *of_block, trial.start_min, late=late)

        return dataclasses.replace(days, estimates=_in_blocks(days.person.size, block, progress, f"{name}: estimates"))

    with one_at_a_time:
        return {fasting: estimated(days) for fasting, days in recorded.items()}


@functools.partial(jax.jit, static_argnames="late")
def _of_days(
    controller: Any,
    t_min: jax.Array,
    basal: jax.Array,
    readings: jax.Array,
    insulin: jax.Array,
    start_min: float | None,
    late: int,
) -> MealEstimates:
    """Estimates of the controller's estimator, with each person's basal rate, along days that trail."""

    def of_day(basal: jax.Array, readings: jax.Array, insulin: jax.Array) -> MealEstimates:
        individual = controller.with_basal(basal)
        none = jnp.zeros_like(readings)
        return replay(
            individual.model, individual.meal_estimator, t_min, readings, insulin, none, basal, late, start_min
        )

    results: MealEstimates = jax.vmap(of_day, in_axes=(0, -1, -1), out_axes=-1)(basal, readings, insulin)
    return results


def _accepted_rates(reported: Array, basal: Array) -> Array:
    """Rates that a controller assumes: the previous one where the pump reports none."""
    rates = np.array(reported)
    for k in range(rates.shape[0]):
        rates[k] = np.where(np.isfinite(rates[k]), rates[k], rates[k - 1] if k else basal)
    return rates


class _Score(NamedTuple):
    """Score of an estimator."""

    tables: dict[str, pl.DataFrame]
    """Tables by the names of their files, in which a number that is not known is null: each meal (its estimates are
    null if it was not detected by then, another one had begun or the day was over), each threshold, the error of the
    size over time, and the first day of the first person."""
    alarms: dict[str, float | None]
    """False alarms at the threshold that was asked for, and the time in which they could happen."""


class Scores(NamedTuple):
    """Scores of all estimators, on as many days with meals as without; people without a basal rate are left out."""

    by_estimator: dict[str, _Score]
    days: int
    infeasible: int


def evaluate(detection: Detection, progress: Callable[[str], None]) -> Scores:
    """Try estimators on days with and without meals.

    `progress` is called with a short description of each finished step. Refusal for a design that is not possible, or
    if no basal rate holds any of the people at the setpoint.
    """
    person, day, infeasible = _who_and_when(detection)
    if not person.size:
        raise Refusal(
            f"no basal rate holds any of the {detection.trial.people} people at {detection.trial.target_mg_dl:g} "
            "mg/dl; give more people or another setpoint"
        )
    recorded: dict[str, dict[bool, _Days]] = {}
    cases = {case.label: case for case in detection.trial.cases}
    scores = {}
    for name in detection.tried:
        case = cases.get(name, detection.trial.cases[0])
        if case.label not in recorded:
            recorded[case.label] = _recorded_days(detection, case, person, day, progress)
        days = _with_estimates(detection, name, recorded[case.label], progress)
        scores[name] = _score(detection, days.get(False), days[True])
    return Scores(scores, person.size, infeasible)


def _score(detection: Detection, fed: _Days | None, fasted: _Days) -> _Score:
    """Score of an estimator on days with meals, if there are any, and on as many without."""
    day = _day(detection, fasted if fed is None else fed)
    fed = jax.tree.map(lambda part: part[..., :0], fasted) if fed is None else fed
    grid, meals, eating = detection.trial.grid, fed.meals, fed.estimates.eating
    quiet, always = ~_under_way(meals, grid.t_min), np.ones(fasted.estimates.eating.shape, bool)
    fasting_days, between_days = (_days_of(counted, grid.sample_time_min) for counted in (always, quiet))
    rows = {}
    for threshold in np.unique([*_THRESHOLDS, detection.threshold]).tolist():
        delay, already = _delays_min(eating, grid.t_min, meals, threshold, detection.trial.plan.horizon_min)
        results = np.isfinite(delay)
        between = _false_alarms(eating, quiet, threshold)
        rows[threshold] = {
            "threshold": threshold,
            "delay_median_min": np.median(delay[results]) if results.any() else None,
            "delay_p90_min": np.quantile(delay[results], QUANTILES[-1]) if results.any() else None,
            "missed_pct": 100.0 * (~results & ~already).sum() / delay.size if delay.size else None,
            "already_pct": 100.0 * already.sum() / delay.size if delay.size else None,
            "false_alarms_fasting_per_day": _false_alarms(fasted.estimates.eating, always, threshold) / fasting_days,
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
    return _Score(
        {name: table.with_columns(pl.col(pl.Float64).fill_nan(None)) for name, table in tables.items()}, alarms
    )


def _of_meals(detection: Detection, fed: _Days) -> dict[str, pl.DataFrame]:
    """Each meal, and the error of the size over time."""
    grid, estimates, horizon_min = detection.trial.grid, fed.estimates, detection.trial.plan.horizon_min
    begin_min: Any = fed.meals.t_min
    carbs_g: Any = fed.meals.carbs_g
    delay, already = _delays_min(estimates.eating, grid.t_min, fed.meals, detection.threshold, horizon_min)
    over = _followed_min(fed.meals, horizon_min)

    def estimate(values: Any, at_min: Array) -> Array:
        return _estimate_at(values, grid.t_min, at_min, begin_min + delay, over)

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
        "estimated_g": estimate(estimates.carbs_g, _end_min(fed.meals) + _AFTERMATH_MIN),
        **{f"expected_{after}_min_g": expected(after) for after in JUDGED_AFTER_MIN},
    }
    # day by day
    meals = pl.DataFrame({name: np.broadcast_to(column, begin_min.shape).T.ravel() for name, column in columns.items()})
    rows = []
    for after in (grid.sample_time_min * np.arange(int(_LONGEST_AFTER_MIN / grid.sample_time_min) + 1)).tolist():
        error = (expected(after) - carbs_g).ravel()
        known = error[np.isfinite(error)]
        quantiles = np.quantile(known, QUANTILES) if known.size else np.full(len(QUANTILES), np.nan)
        errors = {f"error_p{100 * share:.0f}_g": quantile for share, quantile in zip(QUANTILES, quantiles, strict=True)}
        rows.append({"after_min": after, **errors, "meals": known.size})
    return {"meals": meals, "size_error": pl.DataFrame(rows)}


def _day(detection: Detection, days: _Days) -> pl.DataFrame:
    """The first day of the first person."""
    trial, t_min = detection.trial, detection.trial.grid.t_min
    eats = meal_model_of(people_of(trial, days.person[:1]).patient, trial.gut)
    meals = absorb(eats, jax.tree.map(lambda part: part[:, :1], days.meals))
    first: _Days = jax.tree.map(lambda part: part[..., 0], days)
    return pl.DataFrame(
        {
            "t_min": t_min,
            "glucose_mg_dl": first.glucose_mg_dl,
            "reading_mg_dl": first.reading_mg_dl,
            "insulin_mU_min": first.insulin_mU_min,
            "eating": first.estimates.eating,
            "emptying_mg_min": np.asarray(meals.emptying_mg_min(t_min.size, trial.grid.sample_time_min))[:, 0],
            "estimated_emptying_mg_min": first.estimates.emptying_mg_min,
            "carbs_g": first.estimates.carbs_g,
            "remaining_g": first.estimates.remaining_g,
        }
    )


def _end_min(meals: Eaten) -> Array:
    """Time at which each meal has been served, ``(meals, days)``."""
    return np.asarray(meals.t_min + np.maximum(meals.carbs_g / SERVED_G_PER_MIN, meals.eating_min))


def _followed_min(meals: Eaten, horizon_min: float) -> Array:
    """Time at which each meal's period ends, by the next meal or the end of the day, ``(meals, days)``."""
    after = np.full((1, meals.t_min.shape[1]), horizon_min)
    followed: Array = np.minimum(np.concatenate([meals.t_min[1:], after]), horizon_min)
    return followed


def _under_way(meals: Eaten, t_min: Array) -> Truths:
    """Whether a meal is being served, or was within the last 60 min, ``(samples, days)``."""
    t = t_min[:, None, None]
    way: Truths = np.any((meals.t_min <= t) & (t <= _end_min(meals) + _AFTERMATH_MIN), axis=1)
    return way


def _delays_min(
    eating: Array, t_min: Array, meals: Eaten, threshold: float, horizon_min: float
) -> tuple[Array, Truths]:
    """Delay of the first sample after each meal's beginning at which the probability is above the threshold.

    It is ``(meals, days)``, with NaN for a meal that was missed, or that began with the probability above the threshold
    already, which is stated beside it. Meals of a day are in their order.
    """
    above = eating > threshold
    last = np.minimum(_end_min(meals) + _AFTERMATH_MIN, _followed_min(meals, horizon_min))
    delay, already = np.full(meals.t_min.shape, np.nan), np.zeros(meals.t_min.shape, bool)
    for row, (begin, until) in enumerate(zip(meals.t_min, last, strict=True)):
        before = np.searchsorted(t_min, begin, side="right") - 1
        already[row] = above[before, np.arange(begin.size)]
        results = above & (t_min[:, None] > begin) & (t_min[:, None] <= until)
        first = t_min[np.argmax(results, axis=0)] - begin
        delay[row] = np.where(results.any(axis=0) & ~already[row], first, np.nan)
    return delay, already


def _false_alarms(eating: Array, quiet: Truths, threshold: float) -> int:
    """Number of rises of the probability above the threshold that begin in a quiet time, ``(samples, days)``."""
    above = eating > threshold
    before = np.concatenate([np.zeros_like(above[:1]), above[:-1]])
    return int((above & ~before & quiet).sum())


def _days_of(quiet: Truths, sample_time_min: float) -> float:
    """Length of the quiet time, in days."""
    return float(quiet.sum() * sample_time_min / MIN_PER_DAY)


def _estimate_at(values: Array, t_min: Array, at_min: Array, since_min: Array, until_min: Array) -> Array:
    """Estimate for each meal at the first sample from a time on, all ``(meals, days)``.

    It is NaN where that sample is before the detection, until when an estimate is about the meal before, or not before
    the end of the meal's period.
    """
    sample = np.searchsorted(t_min, at_min, side="left")
    index = np.minimum(sample, t_min.size - 1)
    at_sample = np.take_along_axis(values, index, axis=0)
    counts = (sample < t_min.size) & (t_min[index] >= since_min) & (t_min[index] < until_min)
    return np.where(counts, at_sample, np.nan)
