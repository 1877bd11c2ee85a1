"""Closed loop with given sensor errors: many sequences of errors, on one person or on many, in one program."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop.cohorts.engine import announced_to
from glucoloop.cohorts.trial import Trial
from glucoloop.control import Controller
from glucoloop.experiments.assemble import PeopleLoop, with_basal_of_each
from glucoloop.experiments.random_keys import keys_of_people
from glucoloop.experiments.surroundings import Surroundings, surroundings_of
from glucoloop.meals import eaten
from glucoloop.meals.plan import draw_meals
from glucoloop.patients.population import VirtualPeople, population, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.sensors.erring import erring
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.cohort import CohortRun
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.simulation.loop import Sampled
from glucoloop.studies.adversary.space import ErrorSpace

Array = npt.NDArray[Any]

VERY_LOW_MG_DL: Final = 54.0
"""Clinically significant hypoglycaemia (Battelino et al., Diabetes Care 42(8), 2019)."""
_LOWEST_PER_MIN: Final = 0.1
"""Weight of 1 mg/dl of the lowest glucose, in minutes below 54 mg/dl."""


@pytree
class _Kept:
    lowest_mg_dl: jax.Array
    below_54_min: jax.Array
    peak_mg_dl: jax.Array


@pytree
class _Fold:
    """Lowest and highest glucose, and time below 54 mg/dl, on the fine grid."""

    point_min: float = static()

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Kept:
        """Values at the start of the run."""
        del insulin_mU_min
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Kept(lowest_mg_dl=glucose_mg_dl, below_54_min=zero, peak_mg_dl=glucose_mg_dl)

    def step(self, kept: _Kept, happened: Sampled, t_min: jax.Array) -> _Kept:
        """Include the time until the next sample."""
        del t_min
        inside = happened.inside_mg_dl
        below = jnp.sum(jnp.where(inside < VERY_LOW_MG_DL, self.point_min, 0.0), axis=0)
        return _Kept(
            lowest_mg_dl=jnp.minimum(kept.lowest_mg_dl, jnp.min(inside, axis=0)),
            below_54_min=kept.below_54_min + below,
            peak_mg_dl=jnp.maximum(kept.peak_mg_dl, jnp.max(inside, axis=0)),
        )


@dataclass(frozen=True)
class Harm:
    """Harm done by errors, ``(n,)`` each."""

    below_54_min: Array
    lowest_mg_dl: Array
    peak_mg_dl: Array

    @property
    def score(self) -> Array:
        """Minutes below 54 mg/dl, and a tenth of a minute for each mg/dl of the lowest glucose below 54.

        Above 54 mg/dl the second part is negative, so that a search has a slope before glucose is low. NaN counts as
        the least harm, so that a search does not look for failures of the simulator.
        """
        score = self.below_54_min + _LOWEST_PER_MIN * (VERY_LOW_MG_DL - self.lowest_mg_dl)
        return np.where(np.isfinite(score), score, -np.inf)


@dataclass(frozen=True)
class Lane:
    """Course of one loop, sample by sample."""

    t_min: Array
    """(samples + 1,) times of the samples and of the horizon."""
    glucose_mg_dl: Array
    """(samples + 1,) glucose of the person."""
    reading_mg_dl: Array
    """(samples,) readings of the sensor."""
    insulin_mU_min: Array
    """(samples,) rates delivered from each sample to the next."""
    status: Array
    """(samples,) `control.Status` of each decision."""


class Attack:
    """A controller of a trial in a loop whose sensor has given errors.

    Parameters
    ----------
    trial : Trial
        The situation: people, meals, pump, and other faults of the sensor, around which the errors are put.
    controller : Controller
        Controller, guarded or not.
    space : ErrorSpace
        Space that fixes the length and the number of stuck stretches of sequences; the size of the errors is free.
    lanes : int
        Number of loops that are simulated side by side.

    Raises
    ------
    ValueError
        For meals that differ from person to person, or a length that is not the trial's.
    """

    def __init__(self, trial: Trial, controller: Controller, space: ErrorSpace, *, lanes: int = 256) -> None:
        if trial.plan.varies:
            raise Refusal("meals that differ between people cannot be searched over; leave their spreads at 0")
        if space.samples != trial.samples:
            raise Refusal(f"errors of {space.samples} samples do not fit a run of {trial.samples}; give as many")
        self.lanes, self._trial, self._space = lanes, trial, space
        self._grid = sample_grid(trial.plan.horizon_min, trial.sample_time_min)
        self._setpoint = trial.target_mg_dl
        around = surroundings_of(trial, trial.cases[0].faults)
        example = self._drawn(np.array([trial.first_person]))
        nowhere = np.full(space.stretches, float(space.samples))
        self._sensor = erring(np.zeros(space.samples), nowhere, space.stretch_samples, around.sensor)
        self._pump = around.pump
        self._loop = PeopleLoop(
            trial,
            controller,
            example,
            self._grid,
            _Fold(point_min=trial.sample_time_min / len(self._grid.inside_min)),
            meals=eaten(trial.plan.nominal()),
            own_announcements=trial.miscounts,
            own=with_basal_of_each(controller),
            around=Surroundings(sensor=self._sensor, pump=around.pump),
            varied=self._erring(np.zeros((space.samples, 1)), nowhere[:, None]),
            precision=trial.precision,
            products=trial.products,
            tell_decisions=True,
        )

    @property
    def engine(self) -> str:
        """Engine of the loops, native or xla."""
        return self._loop.engine

    def one(self, person: int | None) -> VirtualPeople:
        """A person of the population by number, or the nominal patient.

        Raises
        ------
        ValueError
            If no basal rate holds the person at the setpoint.
        """
        if person is None:
            drawn = virtual_people(
                population("nominal", patient=self._trial.patient), self._trial.seed, [0], setpoint_mg_dl=self._setpoint
            )
        else:
            drawn = self._drawn(np.array([person]))
        if not drawn.feasible.all():
            who = "the nominal patient" if person is None else f"person {person} of seed {self._trial.seed}"
            raise Refusal(f"no basal rate holds {who} at {self._setpoint:g} mg/dl; give another person or setpoint")
        return drawn

    def feasible(self, number: int) -> Array:
        """Numbers of the people with a basal rate among the first people of the trial."""
        person = self._trial.first_person + np.arange(number)
        with one_at_a_time:
            return person[self._drawn(person).feasible]

    def on_one(self, who: VirtualPeople, errors: Array, stuck_from: Array) -> Harm:
        """Harm of sequences of errors to one person.

        Parameters
        ----------
        who : VirtualPeople
            One person.
        errors : (samples, n) array
        stuck_from : (stretches, n) array
        """
        n = errors.shape[1]
        return self._in_parts(
            n, lambda place: self._harm(self._run(who, np.zeros_like(place), errors, stuck_from, place))
        )

    def on_people(self, person: Array, errors: Array, stuck_from: Array) -> Harm:
        """Harm to people of the population, each with an individual sequence of errors."""
        with one_at_a_time:
            who = self._drawn(person)
        return self._in_parts(person.size, lambda place: self._harm(self._run(who, place, errors, stuck_from, place)))

    def trace(self, who: VirtualPeople, errors: Array, stuck_from: Array) -> tuple[Lane, Harm]:
        """One loop in detail, with errors ``(samples,)`` and stretches ``(stretches,)``."""
        first = np.zeros(self.lanes, int)
        run = self._run(who, first, errors[:, None], stuck_from[:, None], first)
        if run.reading_mg_dl is None or run.status is None:
            raise TypeError("this cohort tells no readings and statuses; make it with tell_decisions")
        lane = Lane(
            t_min=np.append(self._grid.t_min, self._trial.plan.horizon_min),
            glucose_mg_dl=run.glucose_mg_dl[:, 0],
            reading_mg_dl=run.reading_mg_dl[:, 0],
            insulin_mU_min=run.insulin_mU_min[:, 0],
            status=run.status[:, 0],
        )
        return lane, _taken(self._harm(run), 1)

    def _drawn(self, person: Array) -> VirtualPeople:
        trial = self._trial
        return virtual_people(trial.population, trial.seed, person, setpoint_mg_dl=self._setpoint)

    def _in_parts(self, n: int, run: Any) -> Harm:
        """Results of n loops, in parts as large as the number of lanes; the last part is filled up."""
        parts = []
        for start in range(0, n, self.lanes):
            place = np.arange(start, min(start + self.lanes, n))
            parts.append(_taken(run(np.resize(place, self.lanes)), place.size))
        return Harm(**{field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in _FIELDS})

    def _run(self, who: VirtualPeople, place: Array, errors: Array, stuck_from: Array, sequence: Array) -> CohortRun:
        """Run one full set of lanes, with the person and the sequence of errors of each."""
        with one_at_a_time:
            people, around = who.at(place), self._erring(errors[:, sequence], stuck_from[:, sequence])
            key = keys_of_people(self._trial.seed, people.draw.person)
            told = self._announced_to(people.draw.person)
        return self._loop.run(people, key, around=around, announced_g=told, threads=os.cpu_count() or 1)

    def _announced_to(self, person: Array) -> Array | None:
        """Carbohydrate as each person counts it; None where nobody miscounts."""
        trial = self._trial
        return announced_to(trial, draw_meals(trial.plan, trial.seed, person), person) if trial.plan.meals else None

    def _erring(self, errors: Array, stuck_from: Array) -> Surroundings:
        own = dataclasses.replace(self._sensor, errors=jnp.asarray(errors), stuck_from=jnp.asarray(stuck_from))
        return Surroundings(sensor=own, pump=self._pump)

    def _harm(self, run: CohortRun) -> Harm:
        return Harm(**{field.name: getattr(run.fold, field.name) for field in _FIELDS})


_FIELDS: Final = dataclasses.fields(Harm)


def _taken(harm: Harm, n: int) -> Harm:
    return Harm(**{field.name: getattr(harm, field.name)[:n] for field in _FIELDS})
