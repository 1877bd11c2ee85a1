"""Simulated days of people under a controller, recorded as an estimator would see them."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from typing import Any, Final, Protocol, Self, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop.control.catalogue import ESTIMATING, complete
from glucoloop.estimation.unknown_meal.replay import MealEstimates, replay
from glucoloop.experiments.assemble import PeopleLoop, with_basal_of_each
from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.random_keys import keys_of_people
from glucoloop.experiments.surroundings import surroundings_of
from glucoloop.meals import Eaten
from glucoloop.meals.plan import draw_meals
from glucoloop.patients.population import virtual_people
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.simulation.loop import Sampled
from glucoloop.simulation.plant import SampleGrid
from glucoloop.situations.case import Case
from glucoloop.studies.detection.detection import Detection
from glucoloop.studies.detection.scores import in_order
from glucoloop.units import MIN_PER_DAY

Array = npt.NDArray[Any]

_MOST_AT_ONCE: Final = 64


@pytree
class Recorder:
    """Record of the sensor and the pump, sample by sample, in place of metrics."""

    sample_time_min: float = static()
    samples: int = static()

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> dict[str, jax.Array]:
        """State of an empty record."""
        del glucose_mg_dl, insulin_mU_min
        return {"reading": jnp.full(self.samples, jnp.nan), "reported": jnp.full(self.samples, jnp.nan)}

    def step(self, state: dict[str, jax.Array], happened: Sampled, t_min: jax.Array) -> dict[str, jax.Array]:
        """Record one more sample."""
        index = jnp.round(t_min / self.sample_time_min).astype(int)
        reading = jnp.where(happened.reading.valid, happened.reading.glucose_mg_dl, jnp.nan)
        said = {"reading": reading, "reported": happened.delivery.reported_mU_min}
        return {
            name: jax.lax.dynamic_update_index_in_dim(state[name], said[name], index, 0)
            for name in ("reading", "reported")
        }


@dataclass(frozen=True)
class Days:
    """Recorded days; days trail."""

    person: npt.NDArray[np.int64]
    day: npt.NDArray[np.int64]
    meals: Eaten
    basal_insulin_mU_min: Array
    reading_mg_dl: Array
    """(samples, days) readings, NaN where there was none."""
    insulin_mU_min: Array
    """(samples, days) rates as the pump reported them, from each sample to the next."""
    glucose_mg_dl: Array
    """(samples, days) glucose free of noise."""


class DayLoop:
    """A controller of a trial with its loop, compiled, for days of its people.

    Parameters
    ----------
    detection : Detection
    label : str
        Label of the case.

    Raises
    ------
    ValueError
        For a design that is not possible.
    """

    def __init__(self, detection: Detection, label: str) -> None:
        trial = detection.trial
        case = next(case for case in trial.cases if case.label == label)
        self.grid = day_grid(detection)
        self._detection = detection
        self._setpoint = trial.target_mg_dl
        controller = controller_of(trial, case)
        example = virtual_people(trial.population, trial.seed, [trial.first_person], setpoint_mg_dl=self._setpoint)
        self._loop = PeopleLoop(
            trial,
            controller,
            example,
            self.grid,
            Recorder(sample_time_min=self.grid.sample_time_min, samples=self.grid.samples),
            meals=None,
            own=with_basal_of_each(controller),
            around=surroundings_of(trial, case.faults),
            engine="xla",
        )

    def run(self, person: npt.NDArray[np.int64], day: npt.NDArray[np.int64], *, fasting: bool, size: int) -> Days:
        """Carry people through a day each.

        Parameters
        ----------
        person, day : (n,) array of int
            Number of the person, and number of the day of that person.
        fasting : bool
            Whether the day is without meals; it then has noise of its own.
        size : int
            Number of days that are computed at once, n or more; the rest is filled up by repetition.
        """
        trial, n = self._detection.trial, person.size
        whose, which = np.resize(person, size), np.resize(day, size)
        with one_at_a_time:
            drawn = virtual_people(trial.population, trial.seed, whose, setpoint_mg_dl=self._setpoint)
            meals = _meals(self._detection, whose, which, fasting=fasting)
            keys = jax.vmap(jax.random.fold_in)(keys_of_people(trial.seed, whose), jnp.asarray(2 * which + fasting))
        run = self._loop.run(drawn, keys, meals=meals)
        return Days(
            person=person,
            day=day,
            meals=jax.tree.map(lambda part: part[:, :n], meals),
            basal_insulin_mU_min=drawn.basal_insulin_mU_min[:n],
            reading_mg_dl=run.fold["reading"][:, :n],
            insulin_mU_min=run.fold["reported"][:, :n],
            glucose_mg_dl=np.asarray(run.glucose_mg_dl, np.float64)[:-1, :n],
        )


def _meals(detection: Detection, person: npt.NDArray[np.int64], day: npt.NDArray[np.int64], *, fasting: bool) -> Eaten:
    """Meals of days, ``(meals, days)``; a fasting day has as many of 0 g, so that it is the same program."""
    number = len(detection.plan.meals)
    if fasting or not number:
        none = np.zeros((max(1, number), person.size))
        return Eaten(t_min=none, carbs_g=none, eating_min=none)
    drawn = draw_meals(detection.plan, detection.trial.seed, person)
    rows, columns = day * number + np.arange(number)[:, None], np.arange(person.size)
    of_day = jax.tree.map(lambda part: part[rows, columns], drawn)
    return in_order(dataclasses.replace(of_day, t_min=of_day.t_min - MIN_PER_DAY * day))


def day_grid(detection: Detection) -> SampleGrid:
    """Samples of a day."""
    return sample_grid(detection.trial.plan.horizon_min, detection.trial.sample_time_min)


def who_and_when(detection: Detection) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], int]:
    """Person and day of every run of people with a basal rate, and the number of people without one."""
    trial = detection.trial
    person = trial.first_person + np.arange(trial.people, dtype=np.int64)
    feasible = virtual_people(trial.population, trial.seed, person, setpoint_mg_dl=trial.target_mg_dl).feasible
    held = person[feasible]
    day = np.arange(detection.days, dtype=np.int64)
    return np.repeat(held, day.size), np.tile(day, held.size), int((~feasible).sum())


def in_even_blocks(total: int) -> tuple[int, int]:
    """Number of blocks and their size, as even as can be."""
    blocks = -(-total // _MOST_AT_ONCE)
    return blocks, -(-total // blocks)


@runtime_checkable
class HoldsEstimator(Protocol):
    """Protocol of a controller that depends on an estimator of meals."""

    model: Any
    """Model of the person, an `estimation.unknown_meal.FedModel`."""
    estimator: Any
    """Estimator, an `estimation.unknown_meal.MealEstimator`."""

    def with_basal(self, insulin_mU_min: jax.Array) -> Self:
        """The same controller for a person with the given basal rate."""
        ...


class Estimator:
    """An estimator of unknown meals, with the settings of the controller that uses it, over recorded days.

    Parameters
    ----------
    detection : Detection
    name : str

    Raises
    ------
    ValueError
        For a design that is not possible.
    """

    def __init__(self, detection: Detection, name: str) -> None:
        trial, grid = detection.trial, day_grid(detection)
        tuning = {**_usual_tuning(detection), **detection.settings, "estimator": name}
        known = trial.cases[0].known_dead_time
        case = Case(label=name, controller=ESTIMATING.name, tuning=tuning, known_dead_time=known)
        controller = controller_of(trial, case)
        if not isinstance(controller, HoldsEstimator):
            raise TypeError(f"{ESTIMATING.name} of the catalogue holds no estimator of meals")
        self._controller = controller
        self._start_min = trial.start_min
        self._t_min, self._late = jnp.asarray(grid.t_min), trial.dead_time_samples if known else 0

    def over(self, days: Days, *, size: int) -> MealEstimates:
        """Estimates along days ``(samples, days)``, of which `size` are computed at once."""
        n = days.person.size
        place = np.resize(np.arange(n), size)
        rates = _believed(days.insulin_mU_min, days.basal_insulin_mU_min)
        with one_at_a_time:
            told: MealEstimates = _of_days(
                self._controller,
                self._t_min,
                jnp.asarray(days.basal_insulin_mU_min[place]),
                jnp.asarray(days.reading_mg_dl[:, place]),
                jnp.asarray(rates[:, place]),
                self._start_min,
                late=self._late,
            )
            asked: MealEstimates = jax.tree.map(lambda leaf: np.asarray(leaf)[..., :n], told)
            return asked


@functools.partial(jax.jit, static_argnames="late")
def _of_days(
    controller: HoldsEstimator,
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

    told: MealEstimates = jax.vmap(of_day, in_axes=(0, -1, -1), out_axes=-1)(basal, readings, insulin)
    return told


def _believed(reported: Array, basal: Array) -> Array:
    """Rates that a controller assumes: the previous one where the pump reports none."""
    rates = np.array(reported)
    for k in range(rates.shape[0]):
        rates[k] = np.where(np.isfinite(rates[k]), rates[k], rates[k - 1] if k else basal)
    return rates


def _usual_tuning(detection: Detection) -> dict[str, Any]:
    return complete(ESTIMATING.name, {}, *detection.trial.whom, noisy=detection.trial.noise_variance > 0.0)
