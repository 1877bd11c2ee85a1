"""Plausible sensor errors, and the closed loop with them: many sequences, on one person or on many, in one program.

Errors are bounded in size, and in a few stretches the reading is stuck.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop._pytree import pytree, static
from glucoloop.build.surroundings import Surroundings, surroundings_of
from glucoloop.control import Controller, Status
from glucoloop.patients.population import VirtualPeople, population, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.sensors.erring import erring
from glucoloop.simulation.cohort import CohortRun
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.simulation.loop import Sampled
from glucoloop.studies.adversary import Adversary
from glucoloop.threefry import uniforms
from glucoloop.trials.engine import brought, loop_of, people_of
from glucoloop.trials.people import in_blocks
from glucoloop.trials.trial import Trial
from glucoloop.tuning.evolution import Evolution

Array = npt.NDArray[Any]

VERY_LOW_MG_DL: Final = 54.0
"""Clinically significant hypoglycaemia (Battelino et al., Diabetes Care 42(8), 2019)."""
_LOWEST_PER_MIN: Final = 0.1
"""Weight of 1 mg/dl of the lowest glucose, in minutes below 54 mg/dl."""


@dataclass(frozen=True)
class ErrorSpace:
    """All sequences of errors that a sensor may make.

    A sequence is a point with coordinates from -1 to 1: the errors one after the other, each relative to the largest,
    and then the moments at which the stuck stretches begin, from the first sample to the last.
    """

    samples: int
    error: float
    """Largest relative error: 0.1 is 10 % of the true glucose."""
    hold_samples: int = 3
    """Number of samples for which an error stays the same."""
    stretches: int = 3
    """Number of stretches in which the reading is stuck."""
    stretch_samples: int = 6
    """Number of equal readings in each stretch."""

    @property
    def pieces(self) -> int:
        """Number of errors of a sequence, each of which holds for some samples."""
        return -(-self.samples // self.hold_samples)

    @property
    def dimension(self) -> int:
        """Number of coordinates of a point."""
        return self.pieces + self.stretches

    def centre(self, rng: np.random.Generator) -> Array:
        """Point ``(dimension,)`` without any error, with the stuck stretches anywhere."""
        return np.concatenate([np.zeros(self.pieces), rng.uniform(-1.0, 1.0, self.stretches)])

    def random_points(self, seed: int, person: npt.NDArray[np.int64]) -> Array:
        """Each person's own point, ``(n, dimension)``, drawn uniformly from a seed and the person's number."""
        return np.stack([2.0 * uniforms(seed, "sensor error", person, i) - 1.0 for i in range(self.dimension)], axis=1)

    def points_of(self, smaller: ErrorSpace, points: Array) -> Array:
        """Points ``(..., dimension)`` of this space for those of one with smaller errors: the same sequences."""
        if dataclasses.replace(smaller, error=self.error) != self or smaller.error > self.error:
            raise Refusal(
                f"sequences of {smaller} are not all in {self}; give a space of smaller errors, else the same"
            )
        ratio = smaller.error / self.error if self.error else 0.0
        return np.concatenate([ratio * np.clip(points[..., : self.pieces], -1.0, 1.0), points[..., self.pieces :]], -1)

    def errors(self, points: Array) -> Array:
        """Relative error of each reading, ``(samples, n)``, of points ``(n, dimension)``, clipped to the bounds."""
        pieces = self.error * np.clip(points[:, : self.pieces], -1.0, 1.0)
        return np.repeat(pieces, self.hold_samples, axis=1)[:, : self.samples].T

    def stuck_from(self, points: Array) -> Array:
        """Sample at which each stuck stretch begins, ``(stretches, n)``."""
        share = np.clip(0.5 * (points[:, self.pieces :] + 1.0), 0.0, 1.0)
        return np.minimum(np.floor(share * self.samples), self.samples - 1.0).T


@pytree
class _Harm:
    """Harm done by errors, ``(n,)`` each: lowest and highest glucose, and time below 54 mg/dl, on the fine grid."""

    # arrays of NumPy, and of JAX while the loop is traced
    lowest_mg_dl: Any
    below_54_min: Any
    peak_mg_dl: Any

    @property
    def score(self) -> Array:
        """Minutes below 54 mg/dl, and a tenth of a minute for each mg/dl of the lowest glucose below 54.

        Above 54 mg/dl the second part is negative, so that a search has a slope before glucose is low. NaN counts as
        the minimum harm, so that a search does not look for failures of the simulator.
        """
        score = self.below_54_min + _LOWEST_PER_MIN * (VERY_LOW_MG_DL - self.lowest_mg_dl)
        return np.where(np.isfinite(score), score, -np.inf)


@pytree
class _Fold:
    """Harm of a run, kept along its samples."""

    point_min: float = static()

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Harm:
        del insulin_mU_min
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Harm(lowest_mg_dl=glucose_mg_dl, below_54_min=zero, peak_mg_dl=glucose_mg_dl)

    def step(self, harm: _Harm, happened: Sampled, t_min: jax.Array) -> _Harm:
        del t_min
        inside = happened.inside_mg_dl
        below = jnp.sum(jnp.where(inside < VERY_LOW_MG_DL, self.point_min, 0.0), axis=0)
        return _Harm(
            lowest_mg_dl=jnp.minimum(harm.lowest_mg_dl, jnp.min(inside, axis=0)),
            below_54_min=harm.below_54_min + below,
            peak_mg_dl=jnp.maximum(harm.peak_mg_dl, jnp.max(inside, axis=0)),
        )


class Attack:
    """A controller of a trial, guarded or not, in a loop whose sensor has given errors, around the trial's own faults.

    The space fixes the length and the number of stuck stretches of sequences; the size of the errors is free. `lanes`
    loops are simulated side by side. Refusal for meals that differ from person to person, or a length that is not the
    trial's.
    """

    def __init__(self, trial: Trial, controller: Controller, space: ErrorSpace, *, lanes: int = 256) -> None:
        if trial.plan.varies:
            raise Refusal("meals that differ between people cannot be searched over; leave their spreads at 0")
        if space.samples != trial.samples:
            raise Refusal(f"errors of {space.samples} samples do not fit a run of {trial.samples}; give as many")
        self.lanes, self._trial = lanes, trial
        surroundings = surroundings_of(trial, trial.cases[0].faults)
        none, nowhere = np.zeros(space.samples), np.full(space.stretches, float(space.samples))
        sensor = erring(none, nowhere, space.stretch_samples, surroundings.sensor)
        self._surroundings = Surroundings(sensor=sensor, pump=surroundings.pump)
        self._loop = loop_of(
            trial,
            controller,
            _Fold(point_min=trial.sample_time_min / len(trial.grid.inside_min)),
            surroundings=self._surroundings,
            varied=self._erring(none[:, None], nowhere[:, None]),
            record_decisions=True,
        )

    @property
    def engine_facts(self) -> dict[str, str]:
        """Engine of the loops, and what native code lacks for them, as `PeopleLoop.engine_facts`."""
        return self._loop.engine_facts

    def person(self, number: int | None) -> VirtualPeople:
        """A person of the population by number, or the nominal patient; Refusal for one without a basal rate.

        The nominal patient of a trial of one person is that person.
        """
        trial = self._trial
        alike = number is None and trial.one_person is None
        source = population("nominal", patient=trial.patient.display_name) if alike else trial.population
        people = virtual_people(source, trial.seed, [number or 0], setpoint_mg_dl=trial.target_mg_dl)
        if not people.feasible.all():
            who = "the nominal patient" if alike else f"person {number or 0} of seed {trial.seed}"
            raise Refusal(f"no basal rate holds {who} at {trial.target_mg_dl:g} mg/dl; give another person or setpoint")
        return people

    def people(self, number: int) -> VirtualPeople:
        """People with a basal rate among the first of the trial."""
        trial = self._trial
        with one_at_a_time:
            first = people_of(trial, trial.first_person + np.arange(number))
            return first.at(np.flatnonzero(first.feasible))

    def harm(self, who: VirtualPeople, errors: Array, stuck_from: Array) -> _Harm:
        """Harm of errors ``(samples, n)`` with stretches ``(stretches, n)``, to one person or to n.

        The last set of lanes is filled up.
        """
        one, none = who.draw.person.size == 1, np.zeros(0)

        def run(lanes: Array, n: int) -> _Harm:
            return _first(self._run(who, 0 * lanes if one else lanes, errors, stuck_from, lanes), n)

        nobody = _Harm(lowest_mg_dl=none, below_54_min=none, peak_mg_dl=none)
        parts = in_blocks(run, np.arange(errors.shape[1]), self.lanes, threads=1)  # each set has all threads
        harm: _Harm = jax.tree.map(lambda *of_parts: np.concatenate(of_parts), nobody, *parts)
        return harm

    def trace(self, who: VirtualPeople, errors: Array, stuck_from: Array) -> tuple[pl.DataFrame, _Harm]:
        """One loop, a row for each sample, and its harm, with errors ``(samples,)`` and stretches ``(stretches,)``."""
        lanes = np.zeros(self.lanes, int)
        run: Any = self._run(who, lanes, errors[:, None], stuck_from[:, None], lanes)
        columns = {
            "t_min": self._trial.grid.t_min,
            "glucose_mg_dl": run.glucose_mg_dl[:-1, 0],
            "reading_mg_dl": run.reading_mg_dl[:, 0],
            "error_of_reading_pct": 100.0 * errors,
            "insulin_mU_min": run.insulin_mU_min[:, 0],
            "status": [Status(code).name.lower().replace("_", " ") for code in run.status[:, 0].tolist()],
        }
        return pl.DataFrame(columns), _first(run, 1)

    def _run(self, who: VirtualPeople, place: Array, errors: Array, stuck_from: Array, sequence: Array) -> CohortRun:
        """Run one full set of lanes, with the person and the sequence of errors of each."""
        trial = self._trial
        with one_at_a_time:
            people, surroundings = who.at(place), self._erring(errors[:, sequence], stuck_from[:, sequence])
            day_inputs = brought(trial, trial.drawn_days(people.draw.person))
        return self._loop.run(people, surroundings=surroundings, threads=os.cpu_count() or 1, **day_inputs)

    def _erring(self, errors: Array, stuck_from: Array) -> Surroundings:
        sensor: Any = self._surroundings.sensor
        erring_sensor = dataclasses.replace(sensor, errors=jnp.asarray(errors), stuck_from=jnp.asarray(stuck_from))
        return dataclasses.replace(self._surroundings, sensor=erring_sensor)


def _first(run: CohortRun, n: int) -> _Harm:
    """Harm of the first n loops of a run."""
    harm: _Harm = jax.tree.map(lambda part: part[:n], run.accumulator)
    return harm


Judge = Callable[[Array, Array], Array]
"""Harm ``(n,)`` of sequences of errors ``(samples, n)`` with stuck stretches from the samples ``(stretches, n)`` on."""


@dataclass(frozen=True)
class _Generation:
    """One generation of all starts: the harm of each sequence, and the most harmful sequence so far."""

    number: int
    score: Array
    best_score: float
    best: Array


@dataclass(frozen=True)
class Worst:
    """The worst of the sequences that were tried: errors relative to the true glucose, and their effect."""

    errors: Array
    stuck_from: Array
    """(stretches,) number of the sample at which each stretch begins, in order."""
    harm: _Harm
    loop: pl.DataFrame
    """Course of the loop, see `Attack.trace`."""
    sequences: int
    """Number of sequences that were tried."""


def generations(
    judge: Judge, space: ErrorSpace, effort: Adversary, before: Sequence[Array] = (), start_point: Array | None = None
) -> Iterator[_Generation]:
    """Yield the generations of a search, each as soon as it is known; Refusal without the library of the search.

    Those whose scores are `before` are not simulated again. The sequence `start_point` is tried first, and one of the
    starts continues from it: the worst of smaller errors, so that the harm of larger ones is never less.
    """
    sampler = Evolution(
        space.centre,
        starts=effort.starts,
        population=effort.sequences,
        seed=effort.search_seed,
        start_point=start_point,
    )
    best_score, best = -np.inf, np.zeros(space.dimension)
    for number in range(effort.generations):
        points = sampler.ask()
        if number < len(before):
            score = np.asarray(before[number], float)
        else:
            score = judge(space.errors(points), space.stuck_from(points))
        most = int(np.argmax(score))
        if score[most] > best_score:
            best_score, best = float(score[most]), points[most]
        sampler.tell(score)
        yield _Generation(number=number, score=score, best_score=best_score, best=best)


def judge_of(attack: Attack, who: VirtualPeople) -> Judge:
    """Function that gives the harm done to one person."""
    return lambda errors, stuck_from: attack.harm(who, errors, stuck_from).score


def worst_of(attack: Attack, who: VirtualPeople, space: ErrorSpace, last: _Generation) -> Worst:
    """The worst sequence of a search whose last generation is given, with its effect."""
    point = last.best[None]
    errors, stuck_from = space.errors(point)[:, 0], np.sort(space.stuck_from(point)[:, 0])
    loop, harm = attack.trace(who, errors, stuck_from)
    return Worst(errors, stuck_from, harm, loop, (last.number + 1) * last.score.size)


def random_errors(attack: Attack, space: ErrorSpace, people: int, seed: int) -> _Harm:
    """Harm of random errors to the people of a population with a basal rate, as a comparison for that of a search.

    Each person's errors are drawn uniformly from the space.
    """
    who = attack.people(people)
    points = space.random_points(seed, who.draw.person)
    return attack.harm(who, space.errors(points), space.stuck_from(points))
