"""Simulated days of people under a controller, recorded as an estimator would see them, and estimates along them."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import typing
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop.cohorts.blocks import in_blocks
from glucoloop.cohorts.trial import Trial
from glucoloop.estimation.unknown_meal.replay import MealEstimates, replay
from glucoloop.experiments.assemble import PeopleLoop, with_basal_of_each
from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.random_keys import keys_of_people
from glucoloop.experiments.surroundings import surroundings_of
from glucoloop.meals import Eaten
from glucoloop.meals.plan import draw_meals
from glucoloop.patients.population import VirtualPeople, virtual_people
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.simulation.loop import Sampled
from glucoloop.situations.case import Case
from glucoloop.studies.detection import Detection
from glucoloop.units import MIN_PER_DAY

T = TypeVar("T")
Array = npt.NDArray[Any]
Numbers = npt.NDArray[np.int64]

ENGINE_TOLD: Final = {"engine": "xla", "not_native": "the replay of estimators, which runs in JAX alone"}
"""Engine of the days and of the estimates, as `PeopleLoop.engine_told` has it."""
_MOST_AT_ONCE: Final = 64


def people_of(trial: Trial, person: npt.ArrayLike) -> VirtualPeople:
    """People of a trial at rest at its target, by their numbers."""
    return virtual_people(trial.population, trial.seed, person, setpoint_mg_dl=trial.target_mg_dl)


@pytree
class Recorder:
    """Record of the sensor and the pump, sample by sample, in place of metrics."""

    sample_time_min: float = static()
    samples: int = static()

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> dict[str, jax.Array]:
        """State of an empty record."""
        del glucose_mg_dl, insulin_mU_min
        return {"reading": jnp.full(self.samples, jnp.nan), "reported": jnp.full(self.samples, jnp.nan)}

    def step(self, record: dict[str, jax.Array], happened: Sampled, t_min: jax.Array) -> dict[str, jax.Array]:
        """Record one more sample."""
        index = jnp.round(t_min / self.sample_time_min).astype(int)
        reading = jnp.where(happened.reading.valid, happened.reading.glucose_mg_dl, jnp.nan)
        values = {"reading": reading, "reported": happened.delivery.reported_mU_min}
        return {name: jax.lax.dynamic_update_index_in_dim(record[name], of, index, 0) for name, of in values.items()}


@pytree
class Days:
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


def recorded_days(
    detection: Detection, case: Case, person: Numbers, day: Numbers, progress: Callable[[str], None]
) -> dict[bool, Days]:
    """Days of people under a controller, by whether they are fasting days, which have noise of their own."""
    trial, grid = detection.trial, detection.grid
    controller = controller_of(trial, case)
    loop = PeopleLoop(
        trial,
        controller,
        people_of(trial, [trial.first_person]),
        grid,
        Recorder(sample_time_min=grid.sample_time_min, samples=grid.samples),
        meals=None,
        own=with_basal_of_each(controller),
        around=surroundings_of(trial, case.faults),
        engine=ENGINE_TOLD["engine"],
    )

    def block(fasting: bool, place: Numbers) -> Days:
        whose, which = person[place], day[place]
        with one_at_a_time:
            drawn = people_of(trial, whose)
            meals = _meals(detection, whose, which, fasting=fasting)
            keys = jax.vmap(jax.random.fold_in)(keys_of_people(trial.seed, whose), jnp.asarray(2 * which + fasting))
        run = loop.run(drawn, keys, meals=meals)
        return Days(
            person=whose,
            day=which,
            meals=meals,
            basal_insulin_mU_min=drawn.basal_insulin_mU_min,
            reading_mg_dl=run.fold["reading"],
            insulin_mU_min=run.fold["reported"],
            glucose_mg_dl=np.asarray(run.glucose_mg_dl, np.float64)[:-1],
        )

    # without meals in the plan, days with meals would be fasting days too
    kinds = {False: "days", True: "fasting days"} if trial.plan.meals else {True: "fasting days"}
    return {
        fasting: _in_blocks(person.size, functools.partial(block, fasting), progress, f"{case.label}: {what}")
        for fasting, what in kinds.items()
    }


def _in_blocks(n: int, run: Callable[[Numbers], T], progress: Callable[[str], None], what: str) -> T:
    """Results at n places, which trail, in blocks as even as can be."""
    blocks, done = -(-n // _MOST_AT_ONCE), itertools.count(1)
    parts = in_blocks(
        lambda place, _: run(place),
        np.arange(n),
        -(-n // blocks),
        threads=1,
        done=lambda _: progress(f"{what}, {next(done)} of {blocks} blocks"),
    )
    together: T = jax.tree.map(lambda *of: np.concatenate(of, axis=-1)[..., :n], *parts)
    return together


def _meals(detection: Detection, person: Numbers, day: Numbers, *, fasting: bool) -> Eaten:
    """Meals of days, ``(meals, days)``; a fasting day has as many of 0 g, so that it is the same program."""
    number = len(detection.all_days.meals)
    if fasting or not number:
        none = np.zeros((max(1, number), person.size))
        return Eaten(t_min=none, carbs_g=none, eating_min=none)
    drawn = draw_meals(detection.all_days, detection.trial.seed, person)
    rows, columns = day * number + np.arange(number)[:, None], np.arange(person.size)
    of_day = jax.tree.map(lambda part: part[rows, columns], drawn)
    return in_order(dataclasses.replace(of_day, t_min=of_day.t_min - MIN_PER_DAY * day))


def in_order(meals: Eaten) -> Eaten:
    """Meals of days ``(meals, days)``, sorted by their beginning within each day."""
    order = np.argsort(meals.t_min, axis=0, kind="stable")
    ordered: Eaten = jax.tree.map(lambda part: np.take_along_axis(np.asarray(part), order, 0), meals)
    return ordered


def who_and_when(detection: Detection) -> tuple[Numbers, Numbers, int]:
    """Person and day of every run of people with a basal rate, and the number of people without one."""
    trial = detection.trial
    person = trial.first_person + np.arange(trial.people, dtype=np.int64)
    feasible = people_of(trial, person).feasible
    held = person[feasible]
    day = np.arange(detection.number_of_days, dtype=np.int64)
    return np.repeat(held, day.size), np.tile(day, held.size), int((~feasible).sum())


def with_estimates(
    detection: Detection, name: str, recorded: Mapping[bool, Days], progress: Callable[[str], None]
) -> dict[bool, Days]:
    """Days with the estimates of an estimator, with the settings of the controller that uses it."""
    trial, t_min = detection.trial, jnp.asarray(detection.grid.t_min)
    known, estimating = trial.cases[0].known_dead_time, detection.estimating
    controller = dataclasses.replace(typing.cast(Any, estimating), estimator=name)
    case = Case(label=name, controller=controller, known_dead_time=known).completed_in(trial)
    controller, late = controller_of(trial, case), trial.dead_time_samples if known else 0

    def estimated(days: Days) -> Days:
        basal, rates = days.basal_insulin_mU_min, _believed(days.insulin_mU_min, days.basal_insulin_mU_min)

        def block(place: Numbers) -> Any:
            own = (jnp.asarray(of[..., place]) for of in (basal, days.reading_mg_dl, rates))
            return _of_days(controller, t_min, *own, trial.start_min, late=late)

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
        own = controller.with_basal(basal)
        none = jnp.zeros_like(readings)
        return replay(own.model, own.estimator, t_min, readings, insulin, none, basal, late, start_min)

    found: MealEstimates = jax.vmap(of_day, in_axes=(0, -1, -1), out_axes=-1)(basal, readings, insulin)
    return found


def _believed(reported: Array, basal: Array) -> Array:
    """Rates that a controller assumes: the previous one where the pump reports none."""
    rates = np.array(reported)
    for k in range(rates.shape[0]):
        rates[k] = np.where(np.isfinite(rates[k]), rates[k], rates[k - 1] if k else basal)
    return rates
