"""People of a trial who are dosed from outside, each from the start of the run to its end, then the next person."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax._src import xla_bridge

from glucoloop._pytree import pytree
from glucoloop.build.assemble import AtRest
from glucoloop.build.designs import with_guard
from glucoloop.build.surroundings import surroundings_of
from glucoloop.control import Controller
from glucoloop.control.glucagon import GLUCAGON
from glucoloop.control.guard_settings import guard_of
from glucoloop.meals.habits import LivedDays
from glucoloop.pumps.protocol import gives_bolus
from glucoloop.refusal import Refusal
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.simulation.loop import Sampled
from glucoloop.simulation.vector_stepper import Begun, ExternalDoses, SteppedPeople
from glucoloop.situations.situation import configured
from glucoloop.trials.engine import brought, loop_of, people_of
from glucoloop.trials.people import block_size
from glucoloop.trials.trial import Trial
from glucoloop.units import LARGEST_COUNTER, MIN_PER_DAY, MU_PER_U

_FORKED_FROM_JAX: list[int] = []
"""The process, if it is the copy by a fork of one in which JAX had run, whose threads are not there."""


def _note_fork() -> None:
    if xla_bridge.backends_are_initialized():
        _FORKED_FROM_JAX[:] = [os.getpid()]


if hasattr(os, "register_at_fork"):  # not on Windows, where no process forks
    os.register_at_fork(after_in_child=_note_fork)


def _refuse_fork() -> None:
    """Refuse to compute in a process that was forked after JAX had run: it would wait for JAX's threads for ever."""
    if _FORKED_FROM_JAX:
        raise Refusal(
            "this process was forked from one in which JAX had run, and would wait for its threads for ever; start "
            'processes afresh, as gymnasium.make_vec(..., vector_kwargs={"context": "forkserver"}) does, or leave '
            "vectorization_mode out, for many people in one process"
        )


Array = npt.NDArray[Any]
Numbers = npt.NDArray[np.int64]

_NOT_OF_THE_AGENT: Final = {
    "controller": "the agent takes the place of the controllers",
    "model": "the agent brings what it knows",
    "design": "no controller is designed",
    "metrics": "rewards and info take their place",
    "traces": "every step tells glucose and insulin",
    "shard_people": "nothing is written",
    "actions": "the agent gives all insulin",
    "warm_up_min": "nobody doses in a warm-up",
}
"""Settings of a trial that mean nothing here, and why."""
_MANY: Final = 2048
"""Number of people from which all processors are used."""


@pytree
class _Nothing:
    """Fold that keeps nothing."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> tuple[()]:
        del glucose_mg_dl, insulin_mU_min
        return ()

    def step(self, state: tuple[()], happened: Sampled, t_min: jax.Array) -> tuple[()]:
        del happened, t_min
        return state


@dataclass(frozen=True)
class _Block:
    """Consecutive people of a seed who can begin, and what they eat."""

    begun: Begun
    person: Numbers
    columns: npt.NDArray[np.intp]
    """Places of those who have a basal rate, and so can begin."""
    days: LivedDays


class DosedPeople:
    """A number of people side by side in the situation of a trial, under doses from outside.

    `settings` are the keys of a trial's file. Persons are taken in the order of their numbers, from ``first_person``
    on, each with meals and noise of the seed and number; after ``people`` persons, if that is given, the first one
    comes again. People without a basal rate are left out.

    Raises
    ------
    Refusal
        For settings that are not possible or mean nothing without controllers.
    """

    def __init__(self, settings: Mapping[str, Any], number: int, threads: int | None = None) -> None:
        _refuse_fork()
        for name, reason in _NOT_OF_THE_AGENT.items():
            if name in settings:
                raise Refusal(f"{name} is no setting of an environment: {reason}; leave it out")
        if number < 1:
            raise Refusal(f"{number} people are not possible; give 1 or more")
        self._settings, self.number = dict(settings), number
        if not isinstance(glucagon := settings.get("glucagon", False), bool):
            raise Refusal(f"glucagon is {glucagon!r}, but the agent decides on it; give True or False")
        # any way of dosing it gives the pump its second route; the agent takes its place
        self._settings["glucagon"] = next(iter(GLUCAGON)) if glucagon else None
        self._threads = threads or ((os.cpu_count() or 1) if number >= _MANY else 1)
        self._prepare(configured(Trial, self._settings))

    def _prepare(self, trial: Trial) -> None:
        """Compile the loop of a trial, and go to its first person."""
        self.trial = trial
        self.gives_bolus = trial.patient.subcutaneous and gives_bolus(surroundings_of(trial).pump)
        self.gives_glucagon = trial.glucagon is not None
        guard = None if trial.guard is None else guard_of(trial.patient, trial.guard)

        def dosed(rate_mU_min: jax.Array) -> ExternalDoses:
            bolus = jnp.zeros_like(rate_mU_min) if self.gives_bolus else None
            glucagon = jnp.zeros_like(rate_mU_min) if self.gives_glucagon else None
            return ExternalDoses(
                insulin_mU_min=rate_mU_min,
                bolus_mU=bolus,
                glucagon_ug=glucagon,
                sample_time_min=trial.sample_time_min,
            )

        def controllers_of(people: AtRest) -> Controller:
            basal = jnp.asarray(people.basal_insulin_mU_min)
            return with_guard(dosed(basal), guard, trial.limits, basal)

        self._basal = jnp.asarray(trial.nominal.basal_insulin_mU_min, float)
        controller = with_guard(dosed(self._basal), guard, trial.limits)
        example = people_of(trial, [trial.first_person])
        self._loop = loop_of(trial, controller, _Nothing(), example, controllers_of=controllers_of, stepped=True)
        self._lanes: SteppedPeople = self._loop.cohort.lanes(self.number)
        self._begin_again()

    def _begin_again(self) -> None:
        self._next = 0
        self._block: _Block | None = None
        self.person: Numbers = np.zeros(self.number, np.int64)
        """(people,) number of each person."""
        self._meals: list[Array] = []

    @property
    def engine(self) -> str:
        """Engine of the loop, native or xla."""
        return self._loop.engine

    @property
    def samples(self) -> int:
        """Number of steps from the start of a run to its end."""
        return self.trial.samples

    @property
    def sample(self) -> Numbers:
        """(people,) number of steps since each began."""
        return self._lanes.sample

    @property
    def time_of_day_min(self) -> Array:
        """(people,) minutes after midnight; a run without a ``start`` begins at midnight."""
        return np.asarray((self.trial.start_min or 0.0) + self.sample * self.trial.sample_time_min) % MIN_PER_DAY

    @property
    def glucose_mg_dl(self) -> Array:
        """(people,) glucose, free of noise."""
        return self._lanes.seen.glucose_mg_dl

    @property
    def reading_mg_dl(self) -> Array:
        """(people,) reading of the sensor, NaN where there is none."""
        return self._lanes.seen.reading_mg_dl

    @property
    def insulin_U(self) -> Array:
        """(people,) all insulin delivered in the last step."""
        return self._lanes.seen.infused_mU_min * self.trial.sample_time_min / MU_PER_U

    @property
    def reported_U(self) -> Array:
        """(people,) insulin in the last step as the pump reports it; NaN if it reports nothing."""
        bolus = self._lanes.reported_bolus_mU
        basal_mU = self._lanes.reported_mU_min * self.trial.sample_time_min
        return np.asarray(basal_mU if bolus is None else basal_mU + bolus) / MU_PER_U

    def reset(self, seed: int | None = None) -> None:
        """Let the next persons begin in all places; with a seed the first ones of that seed."""
        _refuse_fork()
        if seed is not None:
            trial = configured(Trial, {**self._settings, "seed": int(seed)})
            if trial.one_person is not None and trial.seed != self.trial.seed:
                self._prepare(trial)  # its constants may be drawn by the seed, and they are part of the loop
            self.trial = trial
            self._begin_again()
        self.begin(np.arange(self.number))

    def begin(self, places: npt.NDArray[np.intp]) -> None:
        """Let the next persons begin in some places."""
        while places.size:
            if self._block is None or not self._block.columns.size:
                self._block = self._next_block()
            block, taken = self._block, min(places.size, self._block.columns.size)
            now, places, columns = places[:taken], places[taken:], block.columns[:taken]
            self._block = _Block(block.begun, block.person, block.columns[taken:], block.days)
            self._lanes.begin(block.begun, columns, now)
            self.person[now] = block.person[columns]
            self._note_meals(block.days, columns, now)

    def _next_block(self) -> _Block:
        trial, size = self.trial, block_size(self.engine)
        first, most = trial.first_person, trial.population.most_people
        possible = (LARGEST_COUNTER + 1 if most is None else most) - first
        available = trial.people if "people" in trial.explicit else possible
        person = first + (self._next + np.arange(size, dtype=np.int64)) % available
        self._next += size
        with one_at_a_time:
            drawn, days = people_of(trial, person), trial.drawn_days(person)
            people = self._loop.people(drawn, **brought(trial, days))
        columns = np.flatnonzero(drawn.feasible)
        if not columns.size:
            raise Refusal(
                f"none of {size} people of {trial.population.name} has a basal rate at {trial.target_mg_dl:g} mg/dl; "
                "choose another setpoint or population"
            )
        return _Block(self._loop.cohort.begin(people), person, columns, days)

    def _note_meals(self, days: LivedDays, columns: npt.NDArray[np.intp], places: npt.NDArray[np.intp]) -> None:
        """Keep the samples and the carbohydrate of the meals, as they are eaten and as they are announced."""
        every = self.trial.sample_time_min
        announced_at_min = np.maximum(days.announced_min, 0.0)
        kept = [np.floor(days.t_min / every), days.carbs_g, np.floor(announced_at_min / every), days.announced_g]
        if not self._meals:
            self._meals = [np.zeros((len(values), self.number)) for values in kept]
        for to, values in zip(self._meals, kept, strict=True):
            to[:, places] = values[:, columns]

    @property
    def announced_g(self) -> Array:
        """(people,) carbohydrate that is announced of the coming step."""
        if not self.trial.announce_meals:
            return np.zeros(self.number)
        return self._carbs_g(self._meals[2] == self.sample, self._meals[3])

    @property
    def eaten_g(self) -> Array:
        """(people,) carbohydrate of meals that began in the last step."""
        return self._carbs_g(self._meals[0] == self.sample - 1, self._meals[1])

    @staticmethod
    def _carbs_g(now: npt.NDArray[np.bool_], carbs_g: Array) -> Array:
        return np.asarray(np.where(now, carbs_g, 0.0).sum(axis=0))

    def step(self, insulin_mU_min: Array, bolus_mU: Array | None = None, glucagon_ug: Array | None = None) -> None:
        """Give everybody a rate and, where the pump can, a bolus and glucagon, and go to the next sample."""
        self._lanes.step(insulin_mU_min, bolus_mU, glucagon_ug, threads=self._threads)
