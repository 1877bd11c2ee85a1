"""Campaign: random people, meals, noise and faults under every controller, with every promise checked.

Person i of a seed is drawn from one of the patient's populations in turn. Under a controller that person has the same
meals, noise and faults with a guard and without; the order in which faults wrap each other differs from controller to
controller. So a loop has a name, by which it can be repeated to the bit.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.cohorts.blocks import block_size, in_blocks
from glucoloop.control import Controller
from glucoloop.control.catalogue import CONTROLLERS, controller_entry
from glucoloop.control.guard import guard_settings_of
from glucoloop.experiments.assemble import PeopleLoop, with_basal_of_each
from glucoloop.experiments.designs import controller_of, with_guard
from glucoloop.experiments.random_keys import keys_of_people
from glucoloop.experiments.surroundings import Surroundings
from glucoloop.parts.guard import guard_of
from glucoloop.parts.patients import USUAL_PATIENT, patient_entry
from glucoloop.patients.model import patient_model
from glucoloop.refusal import Refusal
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.situations.case import usual_case
from glucoloop.situations.situation import Situation, usual_situation
from glucoloop.studies.verification import Verification
from glucoloop.studies.verification.caps import Caps
from glucoloop.studies.verification.drawn import (
    SAMPLE_MIN,
    Floats,
    Numbers,
    Order,
    RandomFaults,
    draw_people,
    draw_random_meals,
    feasible_people,
    populations_in_turn,
    random_faults,
    random_order,
)
from glucoloop.studies.verification.promises import PROMISES, Promises

HORIZON_MIN: Final = 1440.0
SLOW_HORIZON_MIN: Final = 300.0
"""Length of a loop of a slow controller."""
REPEATED: Final = 8
"""Number of loops among which one is repeated, in another order and other blocks."""
MARGIN_PCT: Final = 1.0
"""Smallest difference between a loop with the guard and without it that counts, in percent of the time."""
LISTED: Final = 10
"""Number of broken loops that are listed for each promise and controller."""
_OTHERS: Final = 1_000_000_000
"""Range of numbers over which controllers of other packages are spread by their names."""

Progress = Callable[[int], None]
"""Callback with each number of finished loops."""


def horizon_min(controller: str) -> float:
    """Length of a controller's loops."""
    return SLOW_HORIZON_MIN if controller_entry(controller).slow else HORIZON_MIN


def catalogue_controller(name: str, patient: str = USUAL_PATIENT.name) -> Controller:
    """A controller as the catalogue has it, for a nominal patient and readings without noise."""
    situation = usual_situation(patient)
    return controller_of(situation, usual_case(name, situation))


def circumstances_of(controller: str, seed: int, person: int, patient: str = USUAL_PATIENT.name) -> dict[str, Any]:
    """A person of a campaign, with the meals and faults under a controller, as plain values.

    Meals are pairs of the minute and the carbohydrate in g; faults have the form of `glucoloop run --fault`.
    """
    horizon, populations = horizon_min(controller), populations_in_turn(patient)
    faults = random_faults(_order(seed, controller), seed, [person], sample_grid(horizon, SAMPLE_MIN).samples)
    drawn = draw_random_meals(seed, [person], horizon)
    return {
        "population": populations[person % len(populations)].name,
        "basal_insulin_mU_min": float(draw_people(seed, [person], patient).basal_insulin_mU_min[0]),
        "meals": sorted((float(t), float(g)) for t, g in zip(drawn.t_min[:, 0], drawn.carbs_g[:, 0], strict=True) if g),
        "noise_variance": float(faults.noise_variance[0]),
        "noise_bound_mg_dl": float(faults.noise_bound_mg_dl[0]),
        "faults": faults.texts(0),
    }


def _order(seed: int, controller: str) -> Order:
    names = list(CONTROLLERS)
    # one of another package has the number of its name, whatever else is installed
    other = len(names) + zlib.crc32(controller.encode()) % _OTHERS
    return random_order(seed, names.index(controller) if controller in names else other)


class Closed(NamedTuple):
    """Results of people under one controller, of whom the last axis is."""

    broken: Floats
    """(promises, n) number of samples at which each was broken."""
    first_min: Floats
    """(promises, n) time at which each was first broken."""
    below_60_pct: Floats
    """(n,) percentage of the time below 60 mg/dl."""
    bits: npt.NDArray[np.uint64]
    """(n,) hash of all observations: equal for equal bits."""


class WatchedLoops:
    """The loops of one controller, with a guard or without."""

    def __init__(self, seed: int, controller: Controller, order: Order, horizon: float, situation: Situation) -> None:
        self._situation, self._seed, self._order = situation, seed, order
        self._horizon, self._grid, limits = horizon, sample_grid(horizon, SAMPLE_MIN), situation.limits
        guard = guard_settings_of(controller)
        example = draw_people(seed, np.arange(2), situation.patient.called)
        faults = random_faults(order, seed, np.arange(2), self._grid.samples)
        self.loop = PeopleLoop(
            situation,
            controller,
            example,
            self._grid,
            Promises(
                limits=limits,
                sound=patient_model(situation.patient.called).sound,
                caps=None if guard is None else Caps(settings=guard, limits=limits),
            ),
            meals=None,
            controllers_of=with_basal_of_each(controller),
            surroundings=self._surroundings(faults, 0),
            varied=self._surroundings(faults),
        )

    @property
    def samples(self) -> int:
        """Number of samples of each loop."""
        return self._grid.samples

    def _surroundings(self, faults: RandomFaults, person: int | None = None) -> Surroundings:
        return Surroundings(
            sensor=faults.sensor(person=person), pump=faults.pump(self._situation.limits, person=person)
        )

    def close(self, person: Numbers, progress: Progress = lambda loops: None) -> Closed:
        """Simulate the loops of people."""
        parts = in_blocks(self._block, person, block_size(self.loop.engine), done=progress)
        return Closed(*(np.concatenate(of_blocks, axis=-1) for of_blocks in zip(*parts, strict=True)))

    def _block(self, person: Numbers, n: int) -> Closed:
        faults = random_faults(self._order, self._seed, person, self.samples)
        with one_at_a_time:
            drawn = draw_people(self._seed, person, self._situation.patient.called)
        run = self.loop.run(
            drawn,
            keys_of_people(self._seed, person),
            surroundings=self._surroundings(faults),
            meals=draw_random_meals(self._seed, person, self._horizon),
        )
        points = self.samples * len(self._grid.inside_min)
        return Closed(
            broken=run.fold.broken[:, :n],
            first_min=run.fold.first_min[:, :n],
            below_60_pct=100.0 * run.fold.below_60[:n] / points,
            bits=bits_of([run.glucose_mg_dl, run.insulin_mU_min, *jax.tree.leaves(run.fold)])[:n],
        )


def bits_of(arrays: Sequence[npt.NDArray[Any]]) -> npt.NDArray[np.uint64]:
    """Hash of each person's values, which changes with any single bit: odd factors lose none of them."""
    rows = np.concatenate([np.asarray(a, np.float64).reshape(-1, a.shape[-1]) for a in arrays])
    bits = np.ascontiguousarray(rows).view(np.uint64)
    factors = 2 * np.arange(rows.shape[0], dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(1)
    together: npt.NDArray[np.uint64] = (bits * factors[:, None]).sum(axis=0, dtype=np.uint64)
    return together


def run_campaign(asked: Verification, progress: Progress) -> Iterator[dict[str, dict[str, Any]]]:
    """The loops of each controller, without a guard and then with one, as plain values.

    Each is an ``arm``; with that of the guard comes ``guarding``, its effect on the time below 60 mg/dl.
    """
    pairs, situation = asked.people(), usual_situation(asked.patient)
    if asked.person is None:
        people = feasible_people(asked.seed, max(pairs.values()), asked.patient)
    else:
        people = np.array([asked.person])
        if not draw_people(asked.seed, people, asked.patient).feasible.all():
            raise Refusal(
                f"no basal rate holds person {asked.person} of seed {asked.seed} at the setpoint; give another person"
            )
    for name, number in pairs.items():
        person, order = people[:number], _order(asked.seed, name)
        bare = catalogue_controller(name, asked.patient)
        loops = WatchedLoops(asked.seed, bare, order, horizon_min(name), situation)
        without = loops.close(person, progress)
        yield {"arm": _arm(asked, name, loops, person, without, guarded=False)}
        controller = with_guard(bare, guard_of(patient_entry(asked.patient)), situation.limits)
        loops = WatchedLoops(asked.seed, controller, order, horizon_min(name), situation)
        closed = loops.close(person, progress)
        yield {
            "arm": _arm(asked, name, loops, person, closed, guarded=True),
            "guarding": {"controller": name, **_guarding(person, without.below_60_pct, closed.below_60_pct)},
        }


def _arm(
    asked: Verification, name: str, loops: WatchedLoops, person: Numbers, closed: Closed, *, guarded: bool
) -> dict[str, Any]:
    """Numbers of broken loops, the first of each promise, and the repetition of some loops."""
    again = np.arange(person.size)[::REPEATED][::-1]
    if again.size == person.size:  # nobody would stand elsewhere than before
        again = again[:0]
    differ = person[again][loops.close(person[again]).bits != closed.bits[again]] if again.size else again
    return {
        "controller": name,
        "guarded": guarded,
        "engine": loops.loop.engine,
        # operation that native code lacks for the loops, and in whose code it is
        "not_native": loops.loop.engine_facts.get("not_native"),
        "loops": person.size,
        "samples": person.size * loops.samples,
        "broken": dict(zip(PROMISES, (closed.broken > 0).sum(axis=1).tolist(), strict=True)),
        "repeated": again.size,
        "not_repeated": differ.tolist(),
        "told": [
            {
                "promise": promise,
                "person": (number := int(person[i])),
                "samples": int(closed.broken[place, i]),
                "first_min": float(closed.first_min[place, i]),
                "faults": circumstances_of(name, asked.seed, number, asked.patient)["faults"],
                "repeat": asked.repeat(name, number),
            }
            for place, promise in enumerate(PROMISES)
            for i in np.flatnonzero(closed.broken[place])[:LISTED]
        ],
    }


def _guarding(person: Numbers, bare_pct: Floats, guarded_pct: Floats) -> dict[str, Any]:
    """Time below 60 mg/dl of the same people with a guard and without; a result, not a promise."""
    more = guarded_pct - bare_pct
    worst = int(np.argmax(more))
    return {
        "pairs": person.size,
        "bare_pct": float(bare_pct.mean()),
        "guarded_pct": float(guarded_pct.mean()),
        "better": int((more < -MARGIN_PCT).sum()),
        "worse": int((more > MARGIN_PCT).sum()),
        "worst_pct": float(more[worst]),
        "worst_person": int(person[worst]),
    }
