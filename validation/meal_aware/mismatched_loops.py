"""Loops of the situations in which a controller's model is wrong: all runs as people of one compiled program."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, varying
from glucoloop.build.designs import controller_of, with_guard
from glucoloop.build.random_keys import keys_of_people
from glucoloop.control.guard_settings import GuardSettings
from glucoloop.control.protocol import Controller, Decision, Observation
from glucoloop.faults import Battery, Late, Missing, Occlusion, once
from glucoloop.meals import Eaten
from glucoloop.meals.lehmann_deutsch import LehmannDeutsch
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.capabilities import rest_at
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import Draw, VirtualPeople, population, virtual_people
from glucoloop.pumps import LimitedPump
from glucoloop.sensors import CorrelatedNoise
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.cohort import Cohort, People
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.situations.situation import configured
from glucoloop.therapy import Profile, given_profile
from glucoloop.threefry import uniforms
from glucoloop.trials.people import block_size, in_blocks
from glucoloop.trials.trial import Trial
from glucoloop.tuning.search import move_slots
from meal_aware.measures import Floats, Runs, numbers_at_samples
from meal_aware.situations import HORIZON_MIN, PATIENT, Mismatch

SAMPLE_MIN: Final = 5.0
_NEVER: Final = math.inf
_SETPOINT_MG_DL: Final = 81.0
"""Setpoint of the example from which the loop is compiled."""
_NO_RATE_MU_MIN: Final = 20.0
"""Rate at the start of a person whom no rate holds at the setpoint, and whose run does not count."""

Design = Callable[[float, float], Controller]
"""Function that designs a controller for a setpoint and a noise variance."""


@pytree
class _Digesting:
    """A person with an individual stomach and gut."""

    person: SemilinearPatient
    meal_model: LehmannDeutsch

    def __getattr__(self, name: str) -> Any:
        if name == "person" or name.startswith("__"):  # not made yet, or not a property of a person
            raise AttributeError(name)
        return getattr(self.person, name)


@pytree
class _Aiming:
    """A controller with an individual setpoint, so that people of one loop may differ in it."""

    inner: Any
    setpoint_mg_dl: jax.Array

    def _at(self, observation: Observation) -> Observation:
        return dataclasses.replace(observation, setpoint_mg_dl=self.setpoint_mg_dl)

    def init(self, observation: Observation) -> Any:
        return self.inner.init(self._at(observation))

    def step(self, state: Any, observation: Observation) -> tuple[Any, Decision]:
        state, decision = self.inner.step(state, self._at(observation))
        return state, decision


@pytree
class _NoFold:
    """A fold that computes nothing."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        return jnp.zeros_like(glucose_mg_dl)

    def step(self, state: jax.Array, happened: Any, t_min: jax.Array) -> jax.Array:
        return state


_trial = functools.cache(lambda: configured(Trial, controller="basal", patient=PATIENT))


def designer(controller: str, settings: Mapping[str, Any] | None = None) -> Design:
    """Function that designs a controller of the catalogue, with settings in place of its defaults."""

    @functools.cache
    def design(setpoint_mg_dl: float, variance: float) -> Controller:
        setpoint = {} if setpoint_mg_dl == _SETPOINT_MG_DL else {"setpoint_mg_dl": setpoint_mg_dl}
        sensor = [{"name": "white-noise", "variance": variance}] if variance else []
        case = {"name": controller, **(settings or {})}
        trial = configured(Trial, {"patient": PATIENT, "sensor": sensor, "controller": case, **setpoint})
        return controller_of(trial, trial.cases[0])

    return design


def mismatched_people(row: Mismatch, seed: int, runs: int) -> VirtualPeople:
    """The people of a situation, at steady state at its setpoint."""
    table, number = population("parker2000"), np.arange(runs)
    if row.people == "parker2000":
        return virtual_people(table, seed, number, setpoint_mg_dl=row.setpoint_mg_dl)
    model = patient_entry(table.patient)
    sides = np.random.default_rng(seed).choice([0.6, 1.4], size=(len(table.parameters), runs))
    share = sides if row.people == "corners" else np.ones_like(sides)
    values = {name: model.nominal[name] * share[i] for i, name in enumerate(table.parameters)}
    setpoint = np.full(runs, row.setpoint_mg_dl)
    anybody = model.build(values, np.full(runs, np.nan), setpoint)
    basal, rest = map(np.asarray, rest_at(anybody, jnp.asarray(setpoint)))
    patient = model.build(values, basal, setpoint)
    profile = Profile(basal_mU_min=basal, setpoint_mg_dl=setpoint)
    return VirtualPeople(table.patient, Draw(number, values), patient, basal, rest, np.isfinite(basal), profile)


def _digesting(person: SemilinearPatient, stomach: Mapping[str, float], runs: int | None) -> Any:
    numbers = dataclasses.asdict(LehmannDeutsch(**stomach))
    individual: Any = {name: np.full(runs, n) if runs else n for name, n in numbers.items()}
    return _Digesting(person=person, meal_model=LehmannDeutsch(**individual))


def _once(begin: Floats | float, samples: float) -> Any:
    return dataclasses.replace(once(0, samples), earliest=jnp.asarray(begin), latest=jnp.asarray(begin))


def _surroundings(variance: Floats | float, correlation: Floats | float, begin: Mapping[str, Any]) -> tuple[Any, Any]:
    """Sensor and pump with every fault, each of which begins at an individual sample or never."""
    sensor: Any = CorrelatedNoise().replaced(variance=jnp.asarray(variance), correlation=jnp.asarray(correlation))
    sensor = Late(10.0, schedule=_once(begin["late"], _NEVER), inner=sensor)
    sensor = Missing(schedule=_once(begin["gap"], 12.0), inner=sensor)
    pump: Any = Battery(schedule=_once(begin["battery"], 12.0), inner=LimitedPump(limits=_trial().limits))
    return sensor, Occlusion(schedule=_once(begin["blocked"], 24.0), inner=pump)


def _joined(parts: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: np.concatenate([np.asarray(leaf) for leaf in leaves], axis=-1), *parts)


def _at(many: Any, one: Any, places: npt.NDArray[np.intp]) -> Any:
    """Numbers of the people at some places; numbers that are the same for all are unchanged."""
    return jax.tree.map(lambda leaf, single: leaf[..., places] if np.ndim(leaf) > np.ndim(single) else leaf, many, one)


class MismatchedLoops:
    """Loops of some situations, compiled once for controllers that differ in their numbers.

    Parameters
    ----------
    rows : sequence of Mismatch
        Situations, all with a guard or all without.
    runs : sequence of int
        Number of runs of each.
    seed : int
        Seed of the people, of the noise, and of the times of faults.
    """

    def __init__(self, rows: Sequence[Mismatch], runs: Sequence[int], seed: int) -> None:
        self.rows = tuple(rows)
        self._runs = tuple(runs)
        drawn = [mismatched_people(row, seed, n) for row, n in zip(rows, runs, strict=True)]
        patients = []
        for row, n, people in zip(rows, runs, drawn, strict=True):
            whole = jax.tree.map(lambda leaf, n=n: np.broadcast_to(leaf, n), people.patient)
            patients.append(_digesting(whole, row.stomach, n))
        self._patient = _joined(patients)
        self._basal = np.concatenate([people.basal_insulin_mU_min for people in drawn])
        self._feasible = np.isfinite(self._basal)
        self._basal = np.where(self._feasible, self._basal, _NO_RATE_MU_MIN)
        self._rest = np.where(self._feasible, np.concatenate([people.rest for people in drawn], axis=1), 1.0)
        self._row = np.repeat(np.arange(len(rows)), runs)
        self._setpoint = self._of_rows([row.setpoint_mg_dl for row in rows])
        number = np.concatenate([np.arange(n) for n in runs])
        onset = 12.0 + np.floor(49.0 * uniforms(seed, "onset", number))
        gap = self._of_rows([_NEVER if row.gap_min is None else row.gap_min[0] / SAMPLE_MIN for row in rows])
        begin = {
            "late": np.where(self._of_rows([row.late for row in rows]), 0.0, _NEVER),
            "gap": np.where(gap < 0.0, onset, gap),
            "battery": np.where(self._of_rows([row.flat_battery for row in rows]), onset, _NEVER),
            "blocked": np.where(self._of_rows([row.blocked for row in rows]), onset, _NEVER),
        }
        variance, correlation = (
            self._of_rows([getattr(row, name) for row in rows]) for name in ("variance", "correlation")
        )
        self._sensor, self._pump = _surroundings(variance, correlation, begin)
        self._one_sensor, self._one_pump = _surroundings(0.0, 0.0, dict.fromkeys(begin, _NEVER))
        most = max(1, *(len(row.meals) for row in rows))
        plan = np.asarray([[*row.meals, *[(0.0, 0.0, 0.0)] * (most - len(row.meals))] for row in rows])[self._row]
        self._meals = Eaten(t_min=plan[:, :, 1].T, carbs_g=plan[:, :, 0].T, eating_min=plan[:, :, 2].T)
        self._key = keys_of_people(seed, number)
        self._single = _digesting(_trial().nominal, {}, None)
        self._cohorts: dict[Any, Cohort] = {}

    def _of_rows(self, values: Sequence[Any]) -> npt.NDArray[Any]:
        """Value of each run's situation."""
        return np.asarray(values)[self._row]

    def run(self, design: Design) -> dict[str, Runs]:
        """Close the loops under the controllers of a design.

        Parameters
        ----------
        design : callable
            Function that designs a controller for a setpoint and a noise variance.

        Returns
        -------
        dict
            Runs by name of the situation.
        """
        one, many = self._controllers(design)
        cohort = self._compiled(one, many)
        whole = People(
            patient=self._patient, x=self._rest, insulin_mU_min=self._basal, key=self._key,
            controller=many, sensor=self._sensor, pump=self._pump, meals=self._meals,
        )  # fmt: skip

        def block(places: npt.NDArray[np.intp], asked: int) -> tuple[Floats, Floats]:
            with one_at_a_time:
                people = People(
                    patient=_at(whole.patient, self._single, places),
                    x=whole.x[:, places],
                    insulin_mU_min=whole.insulin_mU_min[places],
                    key=whole.key[places],
                    controller=_at(many, one, places),
                    sensor=_at(self._sensor, self._one_sensor, places),
                    pump=_at(self._pump, self._one_pump, places),
                    meals=jax.tree.map(lambda leaf: leaf[:, places], self._meals),
                )
                for leaf in jax.tree.leaves(vars(people)):
                    if isinstance(leaf, jax.Array):
                        leaf.block_until_ready()
            done = cohort.run(people)
            return np.asarray(done.glucose_mg_dl, float)[:, :asked], np.asarray(done.insulin_mU_min, float)[:, :asked]

        threads = None if cohort.engine == "native" else 1  # JAX has its own
        together = min(block_size(cohort.engine), self._row.size)
        parts = in_blocks(block, np.arange(self._row.size), together, threads)
        glucose, insulin = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
        return dict(self._measured(glucose, insulin))

    def _measured(self, glucose: Floats, insulin: Floats) -> Iterator[tuple[str, Runs]]:
        for i, row in enumerate(self.rows):
            mine = self._row == i
            counted = mine & self._feasible
            numbers = numbers_at_samples(glucose[:, counted], insulin[:, counted], row.setpoint_mg_dl, SAMPLE_MIN)
            run = np.flatnonzero(self._feasible[mine]).astype(np.int64)
            yield row.name, Runs(run=run, numbers=numbers, infeasible=int(mine.sum() - counted.sum()))

    def _controllers(self, design: Design) -> tuple[Any, Any]:
        """Controller of one person, and those of all people, each designed for the situation; numbers trail."""
        designs = sorted({row.designed_for for row in self.rows})
        each = _alike([design(*key) for key in designs])
        which = self._of_rows([designs.index(row.designed_for) for row in self.rows])

        def of_people(path: Any, *leaves: Any) -> Any:
            if ".plant" in jax.tree_util.keystr(path):  # the same for all, and a constant of the program
                return leaves[0]
            return jnp.asarray(np.moveaxis(np.stack([np.asarray(leaf) for leaf in leaves])[which], 0, -1))

        rest = Profile(basal_mU_min=jnp.asarray(self._basal), setpoint_mg_dl=jnp.nan)
        many = given_profile(jax.tree_util.tree_map_with_path(of_people, *each), rest)
        one, guard, limits = each[0], GuardSettings() if self.rows[0].guarded else None, _trial().limits
        one, many = (
            with_guard(one, guard, limits, jnp.asarray(self._basal[0])),
            with_guard(many, guard, limits, jnp.asarray(self._basal)),
        )
        return (
            _Aiming(inner=one, setpoint_mg_dl=jnp.asarray(_SETPOINT_MG_DL)),
            _Aiming(inner=many, setpoint_mg_dl=jnp.asarray(self._setpoint)),
        )

    def _compiled(self, one: Any, many: Any) -> Cohort:
        """Loop for controllers of a structure; it is compiled once for each."""
        shapes = tuple(np.shape(leaf) for leaf in jax.tree.leaves(one))
        key = jax.tree.structure(one), shapes, tuple(varying(many, one))
        if key not in self._cohorts:
            self._cohorts[key] = Cohort(
                self._single, self._patient, one, self._one_sensor, self._one_pump,
                sample_grid(HORIZON_MIN, SAMPLE_MIN), _NoFold(),
                setpoint_mg_dl=_SETPOINT_MG_DL, meals=None,
                varied_controller=many, varied_sensor=self._sensor, varied_pump=self._pump,
            )  # fmt: skip
        return self._cohorts[key]


def _alike(controllers: Sequence[Any]) -> list[Any]:
    """Controllers whose arrays have the same shapes: horizons are padded to the longest."""
    if not all(hasattr(controller, "padded") for controller in controllers):
        return list(controllers)
    horizons = [controller.horizons for controller in controllers]
    most, horizon = max(moves for moves, _ in horizons), max(samples for _, samples in horizons)
    return [
        controller.padded(move_slots(moves, most), horizon)
        for controller, (moves, _) in zip(controllers, horizons, strict=True)
    ]
