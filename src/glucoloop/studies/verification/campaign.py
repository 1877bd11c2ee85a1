"""Campaign: random people, meals, noise and faults under every controller, with every promise checked.

Person i of a seed is drawn from one of the patient's populations in turn. Under a controller that person has the same
meals, noise and faults with a guard and without; the order in which faults wrap each other differs from controller to
controller. So a loop has a name, by which it can be repeated to the bit.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop.control import Controller
from glucoloop.control.catalogue import CONTROLLERS, controller_entry
from glucoloop.experiments.designs import controller_of, with_guard
from glucoloop.parts.guard import guard_of
from glucoloop.parts.patients import USUAL_PATIENT, patient_entry
from glucoloop.refusal import Refusal
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.situations.case import usual_case
from glucoloop.situations.situation import usual_situation
from glucoloop.studies.verification import MOST_LOOPS, USUAL_LOOPS
from glucoloop.studies.verification.invariants import PROMISES
from glucoloop.studies.verification.loops import Array, Closed, Numbers, Progress, WatchedLoops
from glucoloop.studies.verification.people import draw_people, draw_random_meals, feasible_people, population_of
from glucoloop.studies.verification.random_faults import SAMPLE_MIN, Order, random_faults, random_order
from glucoloop.studies.verification.result import Arm, Broken, CampaignResult, Guarding
from glucoloop.threefry import checked_counter

HORIZON_MIN: Final = 1440.0
SLOW_HORIZON_MIN: Final = 300.0
"""Length of a loop of a slow controller."""
SLOW_SHARE: Final = 0.05
"""Number of loops of a slow controller for each loop of another one."""
REPEATED: Final = 8
"""Number of loops among which one is repeated, in another order and other blocks."""
_OTHERS: Final = 1_000_000_000
"""Range of numbers over which controllers of other packages are spread by their names."""
_TOLD: Final = 10
"""Number of broken loops that are listed for each promise and arm."""


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """Definition of a campaign.

    Without a person it has as many people as necessary.

    Parameters
    ----------
    loops : int
        Smallest number of loops.
    seed : int
    controllers : tuple of str
    patient : str
    person : int, optional
        Number of the only person, whose loops are closed.

    Raises
    ------
    ValueError
        For a number of loops out of bounds, a seed or person that does not exist, or an unknown controller.
    """

    loops: int = USUAL_LOOPS
    seed: int = 1
    controllers: tuple[str, ...] = tuple(CONTROLLERS)
    patient: str = USUAL_PATIENT.name
    person: int | None = None

    def __post_init__(self) -> None:
        if isinstance(self.loops, bool) or not isinstance(self.loops, int) or not 1 <= self.loops <= MOST_LOOPS:
            raise Refusal(f"loops is {self.loops!r}; give a whole number from 1 to {MOST_LOOPS}")
        checked_counter("seed", self.seed)
        patient_entry(self.patient)
        if self.person is not None:
            checked_counter("person", self.person)
        for name in self.controllers:
            controller_entry(name)
        if not self.controllers:
            raise Refusal(f"there is no controller to try; give at least one of {', '.join(CONTROLLERS)}")
        if len(set(self.controllers)) < len(self.controllers):
            raise Refusal(f"a controller is named twice in {', '.join(self.controllers)}; leave one out")

    def pairs(self) -> dict[str, int]:
        """Number of people for each controller; each person makes a loop with a guard and one without."""
        if self.person is not None:
            return dict.fromkeys(self.controllers, 1)
        shares = {name: SLOW_SHARE if controller_entry(name).slow else 1.0 for name in self.controllers}
        return {
            name: max(1, math.ceil(self.loops * share / sum(shares.values()) / 2.0 - 1e-9))
            for name, share in shares.items()
        }


def horizon_min(controller: str) -> float:
    """Length of a controller's loops."""
    return SLOW_HORIZON_MIN if controller_entry(controller).slow else HORIZON_MIN


def catalogue_controller(name: str, patient: str = USUAL_PATIENT.name) -> Controller:
    """A controller as the catalogue has it, for a nominal patient and readings without noise.

    Raises
    ------
    ValueError
        For an unknown controller or patient.
    """
    situation = usual_situation(patient)
    return controller_of(situation, usual_case(name, situation))


@dataclass(frozen=True)
class Met:
    """A person, with the meals and faults under a controller."""

    population: str
    basal_insulin_mU_min: float
    meals: tuple[tuple[float, float], ...]
    """Minute and carbohydrate in g of each meal."""
    noise_variance: float
    noise_bound_mg_dl: float
    faults: tuple[str, ...]
    """Faults in the form of `glucoloop run --fault`."""


def met(controller: str, seed: int, person: int, patient: str = USUAL_PATIENT.name) -> Met:
    """A person of a campaign, with the meals and faults under a controller."""
    horizon = horizon_min(controller)
    faults = random_faults(_order(seed, controller), seed, [person], sample_grid(horizon, SAMPLE_MIN).samples)
    drawn = draw_random_meals(seed, [person], horizon)
    eaten = sorted((float(t), float(g)) for t, g in zip(drawn.t_min[:, 0], drawn.carbs_g[:, 0], strict=True) if g > 0.0)
    return Met(
        population=population_of(person, patient).name,
        basal_insulin_mU_min=float(draw_people(seed, [person], patient).basal_insulin_mU_min[0]),
        meals=tuple(eaten),
        noise_variance=float(faults.noise_variance[0]),
        noise_bound_mg_dl=float(faults.noise_bound_mg_dl[0]),
        faults=tuple(faults.texts(0)),
    )


def _order(seed: int, controller: str) -> Order:
    names = list(CONTROLLERS)
    # one of another package has the number of its name, whatever else is installed
    other = len(names) + zlib.crc32(controller.encode()) % _OTHERS
    return random_order(seed, names.index(controller) if controller in names else other)


def run_campaign(campaign: Campaign, progress: Progress | None = None) -> CampaignResult:
    """Carry out a campaign.

    Parameters
    ----------
    campaign : Campaign
    progress : callable, optional
        Called with each number of finished loops. If it raises KeyboardInterrupt, the campaign ends early and returns
        the results so far, marked as interrupted.

    Raises
    ------
    ValueError
        If the person asked for has no basal rate.
    """
    arms: list[Arm] = []
    guarding: list[Guarding] = []
    interrupted = False
    try:
        for arm, figure in _arms(campaign, progress):
            arms.append(arm)
            if figure is not None:
                guarding.append(figure)
    except KeyboardInterrupt:
        interrupted = True
    return CampaignResult(
        patient=campaign.patient,
        seed=campaign.seed,
        arms=tuple(arms),
        guarding=tuple(guarding),
        interrupted=interrupted,
    )


def _arms(campaign: Campaign, progress: Progress | None) -> Iterator[tuple[Arm, Guarding | None]]:
    pairs = campaign.pairs()
    if campaign.person is None:
        people = feasible_people(campaign.seed, max(pairs.values()), campaign.patient)
    else:
        people = np.array([campaign.person])
        if not draw_people(campaign.seed, people, campaign.patient).feasible.all():
            raise Refusal(
                f"no basal rate holds person {campaign.person} of seed {campaign.seed} at the setpoint; "
                "give another person"
            )
    situation = usual_situation(campaign.patient)
    for name in campaign.controllers:
        person = people[: pairs[name]]
        bare = catalogue_controller(name, campaign.patient)
        order = _order(campaign.seed, name)
        below: list[Array] = []
        for guard in (False, True):
            limits = guard_of(patient_entry(campaign.patient)) if guard else None
            controller = with_guard(bare, limits, situation.limits)
            loops = WatchedLoops(campaign.seed, controller, order, horizon_min(name), situation)
            closed = loops.close(person, progress)
            below.append(closed.below_60_pct)
            arm = _arm(campaign, name, guard, loops, person, closed)
            yield arm, _guarding(name, person, below[0], below[1]) if guard else None


def _arm(campaign: Campaign, name: str, guard: bool, loops: WatchedLoops, person: Numbers, closed: Closed) -> Arm:
    again = np.arange(person.size)[::REPEATED][::-1]
    if again.size == person.size:  # nobody would stand elsewhere than before
        again = again[:0]
    differs = person[again][loops.close(person[again]).bits != closed.bits[again]] if again.size else again
    told: list[Broken] = []
    for place, promise in enumerate(PROMISES):
        for i in np.flatnonzero(closed.broken[place])[:_TOLD]:
            number = int(person[i])
            told.append(
                Broken(
                    promise=promise,
                    person=number,
                    samples=int(closed.broken[place, i]),
                    first_min=float(closed.first_min[place, i]),
                    faults=met(name, campaign.seed, number, campaign.patient).faults,
                )
            )
    return Arm(
        controller=name,
        guarded=guard,
        engine=loops.engine,
        not_native=loops.not_native,
        loops=person.size,
        samples=person.size * loops.samples,
        broken=_by_promise((closed.broken > 0).sum(axis=1)),
        repeated=again.size,
        not_repeated=tuple(int(number) for number in differs),
        told=tuple(told),
    )


def _by_promise(counts: Array) -> Mapping[str, int]:
    return {promise: int(count) for promise, count in zip(PROMISES, counts, strict=True)}


def _guarding(name: str, person: Numbers, bare: Array, guarded: Array) -> Guarding:
    more = guarded - bare
    worst = int(np.argmax(more))
    return Guarding(
        controller=name,
        pairs=person.size,
        bare_pct=float(bare.mean()),
        guarded_pct=float(guarded.mean()),
        better=int((more < -Guarding.MARGIN_PCT).sum()),
        worse=int((more > Guarding.MARGIN_PCT).sum()),
        worst_pct=float(more[worst]),
        worst_person=int(person[worst]),
    )
