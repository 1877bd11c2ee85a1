"""Random people, meals and faults, each a function of the seed and the person's number alone.

A person has up to three faults at once of every kind, absurd ones among them. All faults wrap one sensor and one pump,
and each person has individual numbers, by which only the person's own faults ever begin: so a loop is compiled once for
all people.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.episodes import Episodes
from glucoloop.experiments.faulty import put_around
from glucoloop.limits import LARGEST_COUNTER
from glucoloop.meals import Eaten
from glucoloop.parts.faults import DURATION, FAULTS, KEY, PER_DAY, START, FaultPart
from glucoloop.parts.patients import USUAL_PATIENT
from glucoloop.parts.setting import Value
from glucoloop.patients.population import Population, VirtualPeople, populations_of, virtual_people
from glucoloop.pumps import DoseLimits, LimitedPump, Pump
from glucoloop.refusal import Refusal
from glucoloop.sensors import IdealSensor, Sensor, WhiteNoise
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.threefry import uniforms
from glucoloop.units import MIN_PER_DAY

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]

MOST_MEALS: Final = 4
MOST_AT_ONCE: Final = 3
SAMPLE_MIN: Final = 5.0
LONGEST_SAMPLES: Final = 48
_TO_THE_END: Final = 0.15
"""Share of the planned faults that last to the end."""
_RECURS: Final = 0.3
_CHUNK: Final = 1024

SENSOR_KINDS: Final = tuple(entry.name for entry in FAULTS.values() if entry.part == "sensor")
PUMP_KINDS: Final = tuple(
    kind
    for entry in FAULTS.values()
    if entry.part == "pump"
    for kind in ((entry.name,) if entry.both is None else (entry.name, f"{entry.name}, {entry.both}"))
)
"""Kinds of pump faults, from the inside out."""
KINDS: Final = (*SENSOR_KINDS, *PUMP_KINDS)


def populations_in_turn(patient: str = USUAL_PATIENT.name) -> list[Population]:
    """Populations from which people are drawn in turn; the nominal one where the patient has no other."""
    nominal, *others = populations_of(patient).values()
    return others or [nominal]


def draw_people(seed: int, person: npt.ArrayLike, patient: str = USUAL_PATIENT.name) -> VirtualPeople:
    """People drawn from a patient's populations in turn, by their numbers; drawn values are those of the last one."""
    number = np.asarray(person, np.int64)
    each = [virtual_people(population, seed, number) for population in populations_in_turn(patient)]
    turn = number % len(each)

    def in_turn(*of_each: Any) -> Any:
        return np.choose(turn, of_each) if any(map(np.ndim, of_each)) else of_each[0]

    return dataclasses.replace(
        each[-1],
        patient=jax.tree.map(in_turn, *(one.patient for one in each)),
        **{
            name: in_turn(*(getattr(one, name) for one in each))
            for name in ("basal_insulin_mU_min", "rest", "feasible")
        },
    )


def feasible_people(seed: int, wanted: int, patient: str = USUAL_PATIENT.name) -> Numbers:
    """Numbers of the first people who have a basal rate; Refusal if there are not as many."""
    found: list[Numbers] = []
    for start in range(0, LARGEST_COUNTER, _CHUNK):
        if sum(map(len, found)) >= wanted:
            return np.concatenate(found)[:wanted]
        with one_at_a_time:
            feasible = draw_people(seed, np.arange(start, min(start + _CHUNK, LARGEST_COUNTER)), patient).feasible
        found.append(start + np.flatnonzero(feasible))
    raise Refusal(f"seed {seed} has fewer than {wanted} people; give fewer loops")


def draw_random_meals(seed: int, person: npt.ArrayLike, horizon_min: float) -> Eaten:
    """Meals, at most four ``(4, n)`` of 5 to 120 g at any time, eaten at once; a meal of 0 g counts as none."""
    many = np.floor((MOST_MEALS + 1) * uniforms(seed, "meals", person))
    t_min = np.stack([horizon_min * uniforms(seed, "when", person, i) for i in range(MOST_MEALS)])
    carbs_g = np.stack([5.0 + 115.0 * uniforms(seed, "how much", person, i) for i in range(MOST_MEALS)])
    carbs_g = np.where(np.arange(MOST_MEALS)[:, None] < many, carbs_g, 0.0)
    return Eaten(t_min=t_min, carbs_g=carbs_g, eating_min=np.zeros_like(carbs_g))


@dataclass(frozen=True)
class Order:
    """Common part of the faults of a controller's people: their order, and the length of buffers."""

    sensor: tuple[str, ...]
    """Kinds of sensor faults from the inside out."""
    shared: Mapping[str, Mapping[str, Value]]
    """Values of settings that all people share, by kind."""


def random_order(seed: int, number: int) -> Order:
    """Order of faults with the given number."""
    score = [float(uniforms(seed, f"order of {kind}", [number])[0]) for kind in SENSOR_KINDS]

    def whole(name: str, least: int, most: int) -> int:
        return least + int((most - least + 1) * uniforms(seed, name, [number])[0])

    def shared(kind: str) -> dict[str, Value]:
        both = kind.partition(", ")[2]
        return {**({both: True} if both else {}), **{name: draw(whole) for name, draw in _entry(kind).shared.items()}}

    return Order(
        sensor=tuple(kind for _, kind in sorted(zip(score, SENSOR_KINDS, strict=True))),
        shared={kind: shared(kind) for kind in KINDS},
    )


@dataclass(frozen=True)
class RandomFaults:
    """Faults of people and their sizes; ``(n,)`` each."""

    order: Order
    there: Mapping[str, npt.NDArray[np.bool_]]
    """Whether each person has a fault, by kind."""
    settings: Mapping[str, Mapping[str, Floats]]
    """Values of the settings of each kind, in the unit of the setting."""
    episodes: Mapping[str, Episodes]
    """Times of each kind, in samples; that of a planned fault is infinite for one that is not there."""
    noise_variance: Floats
    noise_bound_mg_dl: Floats

    def sensor(self, *, person: int | None = None) -> Sensor:
        """Sensors of all people, or of one."""
        variance, bound_mg_dl = _at((self.noise_variance, self.noise_bound_mg_dl), person)
        sensor: Sensor = WhiteNoise(inner=IdealSensor(), variance=variance, bound_mg_dl=bound_mg_dl)
        for kind in self.order.sensor:
            sensor = self._around(kind, sensor, person)
        return sensor

    def pump(self, limits: DoseLimits, *, person: int | None = None) -> Pump:
        """Pumps of all people, or of one."""
        pump: Pump = LimitedPump(limits=limits)
        for kind in PUMP_KINDS:
            pump = self._around(kind, pump, person, limits)
        return pump

    def _around(self, kind: str, inner: Any, person: int | None, limits: DoseLimits | None = None) -> Any:
        """A sensor or pump with one kind of fault around it, whose numbers are those of people."""
        entry = _entry(kind)
        usual = put_around(inner, entry(**self.order.shared[kind]), SAMPLE_MIN, limits)
        values, there, episodes = _at((dict(self.settings[kind]), self.there[kind], self.episodes[kind]), person)
        if entry.idle:
            values = {name: jnp.where(there, value, entry.idle[name]) for name, value in values.items()}
        numbers = usual.numbers(values, SAMPLE_MIN) if hasattr(usual, "numbers") else values
        if hasattr(usual, "episodes"):
            numbers = {**numbers, "episodes": episodes}
        return dataclasses.replace(usual, **numbers)

    def texts(self, person: int) -> list[str]:
        """Faults of one person in the form of `glucoloop run --fault`, in the order in which they wrap each other."""
        return [self._text(kind, person) for kind in (*self.order.sensor, *PUMP_KINDS) if self.there[kind][person]]

    def _text(self, kind: str, person: int) -> str:
        entry, episodes = _entry(kind), _at(self.episodes[kind], person)
        given = {KEY: episodes.key, **self.order.shared[kind]}
        for setting, values in self.settings[kind].items():
            value = float(values[person])
            given[setting] = int(value) if entry.settings()[setting].kind is int else value
        often, lasts = float(episodes.probability), float(episodes.length)
        if entry.each_sample is not None:
            given[entry.each_sample] = often
        elif entry.timed:
            if often > 0.0:
                given[PER_DAY] = often * (MIN_PER_DAY / SAMPLE_MIN)
            else:
                given[START] = float(episodes.earliest) * SAMPLE_MIN
            if math.isfinite(lasts):
                given[DURATION] = lasts * SAMPLE_MIN
        return entry(**given).text


def random_faults(order: Order, seed: int, person: npt.ArrayLike, samples: int) -> RandomFaults:
    """Faults of some persons in a run of so many samples."""
    people = np.asarray(person, np.int64)

    def drawn(name: str, index: int = 0) -> Floats:
        return uniforms(seed, f"fault {name}", people, index)

    def settings(kind: str) -> dict[str, Floats]:
        def even(low: float, high: float, index: int = 0) -> Floats:
            return low + (high - low) * drawn(f"size {kind}", index)

        return {name: np.asarray(draw(even)) for name, draw in _entry(kind).drawn.items()}

    many = np.floor((MOST_AT_ONCE + 1) * drawn("how many"))
    rank = np.argsort(np.argsort([drawn(f"which {kind}") for kind in KINDS], axis=0), axis=0)
    there = {kind: rank[place] < many for place, kind in enumerate(KINDS)}
    return RandomFaults(
        order=order,
        there=there,
        settings={kind: settings(kind) for kind in KINDS},
        episodes={kind: _episodes(kind, there[kind], samples, drawn) for kind in KINDS},
        noise_variance=np.where(drawn("noise") < 0.3, 0.0, 25.0 * drawn("noise variance") ** 2),
        noise_bound_mg_dl=3.0 + 27.0 * drawn("noise bound"),
    )


def _episodes(kind: str, there: npt.NDArray[np.bool_], samples: int, drawn: Callable[..., Floats]) -> Episodes:
    """Times of a kind of fault for each person, planned or random."""
    first: Any
    length: Any
    often: Any
    if _entry(kind).each_sample is not None:
        often = np.where(there, drawn("share"), 0.0)
        first, length = np.full(there.shape, np.inf), np.where(there, 1.0, np.inf)
    else:
        recurs = there & (drawn(f"by chance {kind}") < _RECURS)
        often = np.where(recurs, 2.0 ** -np.floor(2.0 + 6.0 * drawn(f"often {kind}")), 0.0)
        lasts = 1.0 + np.floor(LONGEST_SAMPLES * drawn(f"length {kind}"))
        # half of those that come again and again last one sample
        lasts = np.where(recurs & (drawn(f"single {kind}") < 0.5), 1.0, lasts)
        length = np.where(~recurs & (drawn(f"endless {kind}") < _TO_THE_END), np.inf, lasts)
        first = np.where(there & ~recurs, np.floor(samples * drawn(f"onset {kind}")), np.inf)
    return Episodes(
        earliest=first,
        latest=first,
        length=length,
        probability=often,
        random=True,
        key=KINDS.index(kind) + 1,  # so that the random draws of each kind differ
    )


def _entry(kind: str) -> type[FaultPart]:
    return FAULTS[kind.partition(", ")[0]]


def _at(many: Any, person: int | None) -> Any:
    """Numbers of people, or those of one of them."""
    return many if person is None else jax.tree.map(lambda values: values[person], many)
