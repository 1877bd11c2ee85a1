"""Loops of a campaign under one controller: random people, meals, noise and faults, with every promise checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.cohorts.blocks import block_size, in_blocks
from glucoloop.control import Controller
from glucoloop.control.guard import guard_settings_of
from glucoloop.control.protocol import gives_boluses
from glucoloop.experiments.assemble import PeopleLoop
from glucoloop.experiments.designs import with_individual_basal
from glucoloop.experiments.random_keys import keys_of_people
from glucoloop.experiments.surroundings import Surroundings
from glucoloop.patients.model import patient_model
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.situations.situation import Situation, usual_situation
from glucoloop.studies.verification.caps import Caps
from glucoloop.studies.verification.invariants import Promises
from glucoloop.studies.verification.people import draw_people, draw_random_meals
from glucoloop.studies.verification.random_faults import SAMPLE_MIN, Order, RandomFaults, random_faults
from glucoloop.studies.verification.watched import WatchedController, WatchedPump, WatchedSensor

Array = npt.NDArray[Any]
Numbers = npt.NDArray[np.int64]
Progress = Callable[[int], None]
"""Callback with each number of finished loops."""

_CHUNK: Final = 4
"""Number of blocks between two checks for an interrupt."""


@dataclass(frozen=True)
class Closed:
    """Results of people under one controller."""

    broken: Array
    """(promises, n) number of samples at which each was broken."""
    first_min: Array
    """(promises, n) time at which each was first broken."""
    below_60_pct: Array
    """(n,) percentage of the time below 60 mg/dl."""
    bits: npt.NDArray[np.uint64]
    """(n,) hash of all observations: equal for equal bits."""


class WatchedLoops:
    """The loops of one controller, with a guard or without."""

    def __init__(
        self, seed: int, controller: Controller, order: Order, horizon: float, situation: Situation | None = None
    ) -> None:
        self._situation = situation = usual_situation() if situation is None else situation
        self._seed, self._order = seed, order
        self._horizon, self._grid, limits = horizon, sample_grid(horizon, SAMPLE_MIN), situation.limits
        settings, boluses = guard_settings_of(controller), gives_boluses(controller)
        caps = None if settings is None else Caps(settings=settings, limits=limits, boluses=boluses)
        example = draw_people(seed, np.arange(2), situation.patient.called)
        faults = random_faults(order, seed, np.arange(2), self._grid.samples)
        self._loop = PeopleLoop(
            situation,
            WatchedController(inner=controller),
            example,
            self._grid,
            Promises(limits=limits, sound=patient_model(situation.patient.called).sound, caps=caps),
            meals=None,
            own=lambda people: WatchedController(inner=with_individual_basal(controller, people.basal_insulin_mU_min)),
            around=Surroundings(
                sensor=WatchedSensor(inner=faults.sensor(person=0)),
                pump=WatchedPump(inner=faults.pump(limits, person=0)),
            ),
            varied=self._around(faults),
        )

    def _around(self, faults: RandomFaults) -> Surroundings:
        return Surroundings(
            sensor=WatchedSensor(inner=faults.sensor()),
            pump=WatchedPump(inner=faults.pump(self._situation.limits)),
        )

    @property
    def engine(self) -> str:
        """Engine of the loops."""
        return self._loop.engine

    @property
    def not_native(self) -> str | None:
        """Operation that native code lacks for the loops, and in whose code it is; None if they run in it."""
        return self._loop.engine_told.get("not_native")

    @property
    def samples(self) -> int:
        """Number of samples of each loop."""
        return self._grid.samples

    def close(self, person: Numbers, progress: Progress | None = None) -> Closed:
        """Simulate the loops of people."""
        parts: list[Closed] = []
        size = block_size(self.engine)
        for start in range(0, person.size, _CHUNK * size):
            chunk = person[start : start + _CHUNK * size]
            parts += in_blocks(self._block, chunk, size)
            if progress is not None:
                progress(chunk.size)
        names = [field.name for field in dataclasses.fields(Closed)]
        return Closed(**{name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in names})

    def _block(self, person: Numbers, n: int) -> Closed:
        seed = self._seed
        faults = random_faults(self._order, seed, person, self.samples)
        with one_at_a_time:
            drawn = draw_people(seed, person, self._situation.patient.called)
        run = self._loop.run(
            drawn,
            keys_of_people(seed, person),
            around=self._around(faults),
            meals=draw_random_meals(seed, person, self._horizon),
        )
        points = self.samples * len(self._grid.inside_min)
        seen = [run.glucose_mg_dl, run.insulin_mU_min, *jax.tree.leaves(run.fold)]
        return Closed(
            broken=run.fold.broken[:, :n],
            first_min=run.fold.first_min[:, :n],
            below_60_pct=100.0 * run.fold.below_60[:n] / points,
            bits=bits_of(seen)[:n],
        )


def bits_of(arrays: Sequence[Array]) -> npt.NDArray[np.uint64]:
    """Hash of each person's values, which changes with any single bit: odd factors lose none of them."""
    rows = np.concatenate([np.asarray(a, np.float64).reshape(-1, a.shape[-1]) for a in arrays])
    words = np.ascontiguousarray(rows).view(np.uint64)
    factors = 2 * np.arange(rows.shape[0], dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(1)
    together: npt.NDArray[np.uint64] = (words * factors[:, None]).sum(axis=0, dtype=np.uint64)
    return together
