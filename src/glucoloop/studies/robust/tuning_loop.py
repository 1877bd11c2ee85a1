"""One loop for every tuning of a controller: its subjects, and the leaves that a tuning changes."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import varying
from glucoloop.build.assemble import of_nominal_person
from glucoloop.build.designs import design_of
from glucoloop.build.random_keys import keys_of_people
from glucoloop.build.surroundings import surroundings_of
from glucoloop.build.titration import profile_of, with_profiles
from glucoloop.component.setting import Tuned
from glucoloop.control import Controller
from glucoloop.patients import Patient
from glucoloop.patients.population import of_people, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case
from glucoloop.therapy import Profile, given_profile
from glucoloop.trials.engine import fold_of, loop_of
from glucoloop.trials.people import block_size
from glucoloop.trials.trial import Trial

Array = npt.NDArray[Any]
Tuning = Mapping[str, float]
"""Values of the tuned numbers; the others are the case's."""

METRICS: Final = ("undershoot_mg_dl", "minimum_mg_dl", "peak_mg_dl", "insulin_total_variation_mU_min")
"""Metrics that are kept of each subject's run."""
_PROBES: Final = (0.0, 0.37, 1.0)
"""Shares of each range at which a controller is designed to find the leaves that a tuning changes."""


@dataclass(frozen=True)
class _Subjects:
    """Subjects at the start of a run, who trail: people first, then the nominal patient."""

    patient: Patient
    rest: npt.NDArray[np.float64]
    """(states, subjects) steady states."""
    basal_insulin_mU_min: npt.NDArray[np.float64]
    """(subjects,) rates under which they rest."""
    profile: Profile
    """(subjects,) profiles of the subjects."""
    key: jax.Array
    """(subjects,) random key of each sensor."""
    people: int
    """Number of subjects that are people."""
    infeasible: int
    """People who were drawn but have no basal rate, and were left out."""

    def at(self, place: npt.NDArray[np.intp]) -> _Subjects:
        """The subjects at the given places, in their order; places may repeat."""
        return dataclasses.replace(
            self,
            patient=of_people(self.patient, place),
            rest=self.rest[:, place],
            basal_insulin_mU_min=self.basal_insulin_mU_min[place],
            profile=of_people(self.profile, place),
            key=self.key[place],
        )

    @property
    def number(self) -> int:
        """Number of all subjects."""
        return int(self.basal_insulin_mU_min.size)


def draw_subjects(trial: Trial, people: int, people_seed: int, *, seeds: int, first_seed: int) -> _Subjects:
    """Draw people and the noises of the nominal patient, at whose setpoint all rest.

    Persons 0 to ``people - 1`` of a seed have the same noise as in a trial of that seed. The noises of the nominal
    patient are those of ``glucoloop run --seed`` from ``first_seed`` on. Refusal if nobody has a basal rate.
    """
    nominal, population = trial.nominal, trial.population
    setpoint_mg_dl = float(nominal.setpoint_mg_dl)
    drawn = virtual_people(population, people_seed, np.arange(people), setpoint_mg_dl=setpoint_mg_dl)
    drawn = with_profiles(trial, drawn)
    feasible = np.flatnonzero(drawn.feasible)
    if not feasible.size:
        raise Refusal(
            f"none of the {people} people of {population.name} has a basal rate that holds {setpoint_mg_dl:g} mg/dl; "
            "choose another population or setpoint"
        )
    leaves, tree = jax.tree.flatten(drawn.patient)
    nominal_leaves = jax.tree.leaves(nominal)
    joined = [
        jnp.concatenate([many[feasible], jnp.broadcast_to(jnp.asarray(one, float), seeds)]) if trails else many
        for many, one, trails in zip(leaves, nominal_leaves, varying(drawn.patient, nominal), strict=True)
    ]
    basal = np.asarray(nominal.basal_insulin_mU_min, float)
    rest = np.asarray(nominal.steady_state(jnp.asarray(basal)), float)
    noise = jax.vmap(jax.random.key)(jnp.arange(first_seed, first_seed + seeds, dtype=jnp.uint32))
    return _Subjects(
        patient=jax.tree.unflatten(tree, joined),
        rest=np.concatenate([drawn.rest[:, feasible], np.repeat(rest[:, None], seeds, axis=1)], axis=1),
        basal_insulin_mU_min=np.append(drawn.basal_insulin_mU_min[feasible], np.full(seeds, basal)),
        profile=jax.tree.map(
            lambda many, one: jnp.concatenate([jnp.asarray(many)[feasible], jnp.full(seeds, one)]),
            drawn.profile,
            profile_of(trial).like(drawn.profile),
        ),
        key=jnp.concatenate([keys_of_people(people_seed, drawn.draw.person[feasible]), noise]),
        people=int(feasible.size),
        infeasible=people - int(feasible.size),
    )


class TuningLoop:
    """A controller of a trial with its compiled loop for many tunings; Refusal if it cannot be designed.

    The numbers of a tuning are leaves of the controller. Those that a search may change have a trailing axis, like
    values that differ between people: a block of the program holds subjects under any tunings, and nothing is compiled
    again for a tuning.

    The ranges of the tuned numbers, `space`, are empty for a fixed controller. `example` holds some of the subjects,
    which show the values that differ between them.
    """

    def __init__(self, trial: Trial, case: Case, space: Sequence[Tuned], example: _Subjects) -> None:
        self._case, self._design_of = case, design_of(trial, case)
        self._grid, self._fold = trial.grid, fold_of(trial)
        self._like_people = functools.partial(of_nominal_person, situation=trial, example=example)
        self._controller = self._design({})
        probes = (
            [self._design({setting.name: setting.at(share) for setting in space}) for share in _PROBES] if space else []
        )
        self._tuned = [
            any(not np.array_equal(leaf, other) for other in others)
            for leaf, *others in zip(*map(jax.tree.leaves, [self._controller, *probes]), strict=True)
        ]
        self._loop = loop_of(
            trial,
            self._controller,
            self._fold,
            example,
            controllers_of=lambda some: self._of(
                [self._controller], np.zeros(some.basal_insulin_mU_min.size, int), some.profile
            ),
            surroundings=surroundings_of(trial, case.faults),
        )
        self.engine_facts = self._loop.engine_facts

    def run(self, subjects: _Subjects, tunings: Sequence[Tuning] = ({},)) -> Iterator[dict[str, Array] | None]:
        """Yield `METRICS` ``(subjects,)`` by name under each tuning, in order, as soon as they are known.

        A tuning that the design refuses gives None.
        """
        n, size = subjects.number, block_size(self._loop.engine)
        possible: list[Controller] = []
        order: list[bool] = []
        """Whether each tuning is possible, for those that are not yielded yet."""

        def jobs() -> Iterator[tuple[int, int]]:
            for tuning in tunings:
                try:
                    possible.append(self._design(tuning))
                except Refusal:
                    order.append(False)
                    continue
                order.append(True)
                which = len(possible) - 1
                yield from ((which, place) for place in range(n))

        waiting, ready, ended = jobs(), np.zeros((len(METRICS), 0)), False
        while not ended:
            # blocks are filled with subjects under one tuning after the other, and only the last is filled up
            block = np.array(list(itertools.islice(waiting, size)), int)
            ended = len(block) < size
            if len(block):
                results = self._block(subjects, possible, *np.resize(block, (size, 2)).T)
                ready = np.hstack([ready, results[:, : len(block)]])
            while order and (not order[0] or ready.shape[1] >= n):
                if order.pop(0):
                    yield dict(zip(METRICS, ready[:, :n], strict=True))
                    ready = ready[:, n:]
                else:
                    yield None

    def _block(self, subjects: _Subjects, controllers: Sequence[Controller], which: Array, place: Array) -> Array:
        """Metrics ``(metrics, size)`` of subjects at places, each under one of the controllers."""
        first, some = int(which.min()), subjects.at(place)
        controller = self._of(controllers[first : which.max() + 1], which - first, some.profile)
        run = self._loop.run(some, some.key, controller=controller)
        metrics = self._fold.finish(
            run.accumulator,
            samples=self._grid.samples,
            sample_time_min=self._grid.sample_time_min,
            meal_t_min=0.0,
            precision=self._loop.cohort.precision,
        )
        return np.array([np.asarray(getattr(metrics, name), float) for name in METRICS])

    def _of(self, controllers: Sequence[Controller], which: Array, profile: Profile) -> Controller:
        """Controllers of subjects, each with its tuning and profile."""
        leaves, tree = jax.tree.flatten(given_profile(self._controller, profile))
        many = [jax.tree.leaves(controller) for controller in controllers]
        joined: Controller = jax.tree.unflatten(
            tree,
            [
                jnp.asarray(np.stack([np.asarray(each[i], float) for each in many], axis=-1)[..., which])
                if self._tuned[i]
                else leaf
                for i, leaf in enumerate(leaves)
            ],
        )
        return joined

    def _design(self, tuning: Tuning) -> Controller:
        controller: Any = self._case.controller
        return self._like_people(self._design_of(dataclasses.replace(controller, **tuning)))
