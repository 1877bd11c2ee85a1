"""Campaign: random people, meals, noise and faults under every controller, with every promise checked.

Person i of a seed is drawn from one of the patient's populations in turn. Under a controller that person has the same
meals, noise and faults with a guard and without; the order in which faults wrap each other differs from controller to
controller. All are functions of the seed and the person's number alone, so a loop has a name, by which it can be
repeated to the bit.

A person has up to three faults at once of every kind, absurd ones among them. All faults wrap one sensor and one pump,
and each person has individual numbers, by which only the person's own faults ever begin: so a loop is compiled once for
all people.
"""

from __future__ import annotations

import dataclasses
import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.build.designs import controller_of, with_guard
from glucoloop.build.random_keys import keys_of_people
from glucoloop.build.surroundings import Surroundings, put_around
from glucoloop.component.request import Request, completed
from glucoloop.component.setting import Value
from glucoloop.control import Controller
from glucoloop.control.catalogue import CONTROLLERS, controller_entry
from glucoloop.control.guard import guard_settings_of
from glucoloop.control.guard_settings import guard_of
from glucoloop.faults import DURATION, FAULTS, KEY, PER_DAY, START, Episodes, FaultComponent
from glucoloop.meals import Eaten
from glucoloop.metrics.promises import PROMISES, Caps, Promises
from glucoloop.patients.catalogue import DEFAULT_PATIENT, PATIENTS, patient_entry
from glucoloop.patients.population import Population, VirtualPeople, populations_of, virtual_people
from glucoloop.patients.table import REPLACED
from glucoloop.pumps import DoseLimits, LimitedPump, Pump
from glucoloop.refusal import Refusal
from glucoloop.sensors import Sensor, WhiteNoise
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.situations.case import default_case
from glucoloop.situations.population import person_of
from glucoloop.situations.situation import Situation, configured
from glucoloop.studies.verification import SAMPLE_MIN, Verification
from glucoloop.therapy import Profile
from glucoloop.threefry import uniforms
from glucoloop.trials.engine import loop_of
from glucoloop.trials.people import block_size, in_blocks
from glucoloop.trials.trial import Trial
from glucoloop.units import LARGEST_COUNTER, MIN_PER_DAY

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]

_MAX_MEALS: Final = 4
_MAX_AT_ONCE: Final = 3
_LONGEST_SAMPLES: Final = 48
_TO_THE_END: Final = 0.15
"""Share of the planned faults that last to the end."""
_RECURS: Final = 0.3
_CHUNK: Final = 1024

_SENSOR_KINDS: Final = tuple(entry.name for entry in FAULTS.values() if entry.part == "sensor")
PUMP_KINDS: Final = tuple(
    kind
    for entry in FAULTS.values()
    if entry.part == "pump"
    for kind in ((entry.name,) if entry.both is None else (entry.name, f"{entry.name}, {entry.both}"))
)
"""Kinds of pump faults, from the inside out."""
KINDS: Final = (*_SENSOR_KINDS, *PUMP_KINDS)


def _populations_in_turn(patient: str = DEFAULT_PATIENT.name, seed: int = 0) -> list[Population]:
    """Populations from which people are drawn in turn, or the one person that the text of the patient names.

    It is the nominal one where the patient has no other.
    """
    part = PATIENTS.choose(patient)
    if part.person is not None:
        return [person_of(part.person, part.display_name, seed)]
    nominal, *others = populations_of(part.display_name).values()
    # any number of people is drawn, of a table with replacement
    return [other if other.most_people is None else other.drawn_as(REPLACED) for other in others] or [nominal]


def _draw_people(seed: int, person: npt.ArrayLike, patient: str = DEFAULT_PATIENT.name) -> VirtualPeople:
    """People drawn from a patient's populations in turn, by their numbers; drawn values are those of the last one."""
    number = np.asarray(person, np.int64)
    each = [virtual_people(population, seed, number) for population in _populations_in_turn(patient, seed)]
    turn = number % len(each)

    def in_turn(*of_each: Any) -> Any:
        return np.choose(turn, of_each) if any(map(np.ndim, of_each)) else of_each[0]

    basal, setpoint = in_turn(*(one.basal_insulin_mU_min for one in each)), each[0].profile.setpoint_mg_dl
    return dataclasses.replace(
        each[-1],
        profile=Profile(basal_mU_min=basal, setpoint_mg_dl=setpoint),
        patient=jax.tree.map(in_turn, *(one.patient for one in each)),
        **{
            name: in_turn(*(getattr(one, name) for one in each))
            for name in ("basal_insulin_mU_min", "rest", "feasible")
        },
    )


def _feasible_people(seed: int, wanted: int, patient: str = DEFAULT_PATIENT.name) -> Numbers:
    """Numbers of the first people who have a basal rate; Refusal if there are not as many."""
    results: list[Numbers] = []
    for start in range(0, LARGEST_COUNTER, _CHUNK):
        if sum(map(len, results)) >= wanted:
            return np.concatenate(results)[:wanted]
        with one_at_a_time:
            feasible = _draw_people(seed, np.arange(start, min(start + _CHUNK, LARGEST_COUNTER)), patient).feasible
        results.append(start + np.flatnonzero(feasible))
    raise Refusal(f"seed {seed} has fewer than {wanted} people; give fewer loops")


def _draw_random_meals(seed: int, person: npt.ArrayLike, horizon_min: float) -> Eaten:
    """Meals, at most four ``(4, n)`` of 5 to 120 g at any time, eaten at once; a meal of 0 g counts as none."""
    many = np.floor((_MAX_MEALS + 1) * uniforms(seed, "meals", person))
    t_min = np.stack([horizon_min * uniforms(seed, "when", person, i) for i in range(_MAX_MEALS)])
    carbs_g = np.stack([5.0 + 115.0 * uniforms(seed, "how much", person, i) for i in range(_MAX_MEALS)])
    carbs_g = np.where(np.arange(_MAX_MEALS)[:, None] < many, carbs_g, 0.0)
    return Eaten(t_min=t_min, carbs_g=carbs_g, eating_min=np.zeros_like(carbs_g))


@dataclass(frozen=True)
class _Order:
    """Common part of the faults of a controller's people: their order, and the length of buffers."""

    sensor: tuple[str, ...]
    """Kinds of sensor faults from the inside out."""
    shared: Mapping[str, Mapping[str, Value]]
    """Values of settings that all people share, by kind."""


def _random_order(seed: int, number: int) -> _Order:
    """Order of faults with the given number."""
    score = [float(uniforms(seed, f"order of {kind}", [number])[0]) for kind in _SENSOR_KINDS]

    def whole(name: str, least: int, most: int) -> int:
        return least + int((most - least + 1) * uniforms(seed, name, [number])[0])

    def shared(kind: str) -> dict[str, Value]:
        both = kind.partition(", ")[2]
        return {**({both: True} if both else {}), **{name: draw(whole) for name, draw in _entry(kind).shared.items()}}

    return _Order(
        sensor=tuple(kind for _, kind in sorted(zip(score, _SENSOR_KINDS, strict=True))),
        shared={kind: shared(kind) for kind in KINDS},
    )


@dataclass(frozen=True)
class _RandomFaults:
    """Faults of people and their sizes; ``(n,)`` each."""

    order: _Order
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
        sensor: Sensor = WhiteNoise().replaced(variance=variance, bound_mg_dl=bound_mg_dl)
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
        around = put_around(inner, completed(Request(entry, self.order.shared[kind])), SAMPLE_MIN, limits)
        values, there, episodes = _at((dict(self.settings[kind]), self.there[kind], self.episodes[kind]), person)
        if entry.idle:
            values = {name: jnp.where(there, value, entry.idle[name]) for name, value in values.items()}
        return around.replaced(**values, **({"episodes": episodes} if "episodes" in around.derived_names() else {}))

    def texts(self, person: int) -> list[str]:
        """Faults of one person in the form of `glucoloop run --fault`, in the order in which they wrap each other."""
        return [self._text(kind, person) for kind in (*self.order.sensor, *PUMP_KINDS) if self.there[kind][person]]

    def _text(self, kind: str, person: int) -> str:
        entry, episodes = _entry(kind), _at(self.episodes[kind], person)
        settings = {KEY: episodes.key, **self.order.shared[kind]}
        for setting, values in self.settings[kind].items():
            value = float(values[person])
            settings[setting] = int(value) if entry.settings()[setting].kind is int else value
        often, lasts = float(episodes.probability), float(episodes.length)
        if entry.each_sample is not None:
            settings[entry.each_sample] = often
        elif entry.timed:
            if often > 0.0:
                settings[PER_DAY] = often * (MIN_PER_DAY / SAMPLE_MIN)
            else:
                settings[START] = float(episodes.earliest) * SAMPLE_MIN
            if math.isfinite(lasts):
                settings[DURATION] = lasts * SAMPLE_MIN
        return entry(**settings).text


def _random_faults(order: _Order, seed: int, person: npt.ArrayLike, samples: int) -> _RandomFaults:
    """Faults of some persons in a run of so many samples."""
    people = np.asarray(person, np.int64)

    def uniform(name: str, index: int = 0) -> Floats:
        return uniforms(seed, f"fault {name}", people, index)

    def settings(kind: str) -> dict[str, Floats]:
        def even(low: float, high: float, index: int = 0) -> Floats:
            return low + (high - low) * uniform(f"size {kind}", index)

        return {name: np.asarray(draw(even)) for name, draw in _entry(kind).drawn.items()}

    many = np.floor((_MAX_AT_ONCE + 1) * uniform("how many"))
    rank = np.argsort(np.argsort([uniform(f"which {kind}") for kind in KINDS], axis=0), axis=0)
    there = {kind: rank[place] < many for place, kind in enumerate(KINDS)}
    return _RandomFaults(
        order=order,
        there=there,
        settings={kind: settings(kind) for kind in KINDS},
        episodes={kind: _episodes(kind, there[kind], samples, uniform) for kind in KINDS},
        noise_variance=np.where(uniform("noise") < 0.3, 0.0, 25.0 * uniform("noise variance") ** 2),
        noise_bound_mg_dl=3.0 + 27.0 * uniform("noise bound"),
    )


def _episodes(kind: str, there: npt.NDArray[np.bool_], samples: int, uniform: Callable[..., Floats]) -> Episodes:
    """Times of a kind of fault for each person, planned or random."""
    first: Any
    length: Any
    often: Any
    if _entry(kind).each_sample is not None:
        often = np.where(there, uniform("share"), 0.0)
        first, length = np.full(there.shape, np.inf), np.where(there, 1.0, np.inf)
    else:
        recurs = there & (uniform(f"by chance {kind}") < _RECURS)
        often = np.where(recurs, 2.0 ** -np.floor(2.0 + 6.0 * uniform(f"often {kind}")), 0.0)
        lasts = 1.0 + np.floor(_LONGEST_SAMPLES * uniform(f"length {kind}"))
        # half of those that come again and again last one sample
        lasts = np.where(recurs & (uniform(f"single {kind}") < 0.5), 1.0, lasts)
        length = np.where(~recurs & (uniform(f"endless {kind}") < _TO_THE_END), np.inf, lasts)
        first = np.where(there & ~recurs, np.floor(samples * uniform(f"onset {kind}")), np.inf)
    return Episodes(
        earliest=first,
        latest=first,
        length=length,
        probability=often,
        random=True,
        key=KINDS.index(kind) + 1,  # so that the random draws of each kind differ
    )


def _entry(kind: str) -> type[FaultComponent]:
    return FAULTS[kind.partition(", ")[0]]


def _at(many: Any, person: int | None) -> Any:
    """Numbers of people, or those of one of them."""
    return many if person is None else jax.tree.map(lambda values: values[person], many)


_HORIZON_MIN: Final = 1440.0
_SLOW_HORIZON_MIN: Final = 300.0
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


def _horizon_min(controller: str) -> float:
    """Length of a controller's loops."""
    return _SLOW_HORIZON_MIN if controller_entry(controller).slow else _HORIZON_MIN


def _trial_of(config: Verification, controller: str) -> Trial:
    """The situation of a controller's loops as a trial, whose people, meals and faults are those of the campaign."""
    settings = {
        "patient": PATIENTS.parse(config.patient),
        "seed": config.seed,
        "duration_min": _horizon_min(controller),
        "meals": (),
    }
    return completed(Request(Trial, settings))


def catalogue_controller(
    name: str, patient: str = DEFAULT_PATIENT.name, sample_time_min: float = SAMPLE_MIN
) -> Controller:
    """A controller as the catalogue has it, for a nominal patient and readings without noise."""
    situation = configured(Situation, patient=patient, sample_time_min=sample_time_min)
    return controller_of(situation, default_case(name, situation))


def circumstances_of(controller: str, seed: int, person: int, patient: str = DEFAULT_PATIENT.name) -> dict[str, Any]:
    """A person of a campaign, with the meals and faults under a controller, as plain values.

    Meals are pairs of the minute and the carbohydrate in g; faults have the form of `glucoloop run --fault`.
    """
    horizon, populations = _horizon_min(controller), _populations_in_turn(patient, seed)
    faults = _random_faults(_order(seed, controller), seed, [person], sample_grid(horizon, SAMPLE_MIN).samples)
    drawn = _draw_random_meals(seed, [person], horizon)
    return {
        "population": populations[person % len(populations)].name,
        "basal_insulin_mU_min": float(_draw_people(seed, [person], patient).basal_insulin_mU_min[0]),
        "meals": sorted((float(t), float(g)) for t, g in zip(drawn.t_min[:, 0], drawn.carbs_g[:, 0], strict=True) if g),
        "noise_variance": float(faults.noise_variance[0]),
        "noise_bound_mg_dl": float(faults.noise_bound_mg_dl[0]),
        "faults": faults.texts(0),
    }


def _order(seed: int, controller: str) -> _Order:
    names = list(CONTROLLERS)
    # one of another package has the number of its name, whatever else is installed
    other = len(names) + zlib.crc32(controller.encode()) % _OTHERS
    return _random_order(seed, names.index(controller) if controller in names else other)


class _Closed(NamedTuple):
    """Results of people under one controller, of whom the last axis is."""

    broken: Floats
    """(promises, n) number of samples at which each was broken."""
    first_min: Floats
    """(promises, n) time at which each was first broken."""
    below_60_pct: Floats
    """(n,) percentage of the time below 60 mg/dl."""
    bits: npt.NDArray[np.uint64]
    """(n,) hash of all observations: equal for equal bits."""


class _WatchedLoops:
    """The loops of one controller, with a guard or without."""

    def __init__(self, trial: Trial, controller: Controller, order: _Order) -> None:
        self._trial, self._order, self.samples = trial, order, trial.samples
        guard = guard_settings_of(controller)
        faults = _random_faults(order, trial.seed, np.arange(2), trial.samples)
        self.loop = loop_of(
            trial,
            controller,
            Promises(
                limits=trial.limits,
                sound=patient_entry(trial.patient.display_name).sound,
                caps=None if guard is None else Caps(settings=guard, limits=trial.limits),
            ),
            _draw_people(trial.seed, np.arange(2), trial.patient.text),
            meals=None,
            surroundings=self._surroundings(faults, 0),
            varied=self._surroundings(faults),
        )

    def _surroundings(self, faults: _RandomFaults, person: int | None = None) -> Surroundings:
        return Surroundings(sensor=faults.sensor(person=person), pump=faults.pump(self._trial.limits, person=person))

    def close(self, person: Numbers, progress: Progress = lambda loops: None) -> _Closed:
        """Simulate the loops of people."""
        parts = in_blocks(self._block, person, block_size(self.loop.engine), done=progress)
        return _Closed(*(np.concatenate(of_blocks, axis=-1) for of_blocks in zip(*parts, strict=True)))

    def _block(self, person: Numbers, n: int) -> _Closed:
        trial, seed = self._trial, self._trial.seed
        faults = _random_faults(self._order, seed, person, self.samples)
        with one_at_a_time:
            people = _draw_people(seed, person, trial.patient.text)
        run = self.loop.run(
            people,
            keys_of_people(seed, person),
            surroundings=self._surroundings(faults),
            meals=_draw_random_meals(seed, person, trial.plan.horizon_min),
        )
        points = self.samples * len(trial.grid.inside_min)
        return _Closed(
            broken=run.accumulator.broken[:, :n],
            first_min=run.accumulator.first_min[:, :n],
            below_60_pct=100.0 * run.accumulator.below_60[:n] / points,
            bits=_bits_of([run.glucose_mg_dl, run.insulin_mU_min, *jax.tree.leaves(run.accumulator)])[:n],
        )


def _bits_of(arrays: Sequence[npt.NDArray[Any]]) -> npt.NDArray[np.uint64]:
    """Hash of each person's values, which changes with any single bit: odd factors lose none of them."""
    rows = np.concatenate([np.asarray(a, np.float64).reshape(-1, a.shape[-1]) for a in arrays])
    bits = np.ascontiguousarray(rows).view(np.uint64)
    factors = 2 * np.arange(rows.shape[0], dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(1)
    together: npt.NDArray[np.uint64] = (bits * factors[:, None]).sum(axis=0, dtype=np.uint64)
    return together


def run_campaign(config: Verification, progress: Progress, done: int = 0) -> Iterator[dict[str, dict[str, Any]]]:
    """The loops of each controller, without a guard and then with one, as plain values, after the first `done` of them.

    Each is an ``arm``; with that of the guard comes ``guarding``, its effect on the time below 60 mg/dl.
    """
    pairs = config.people()
    if config.person is None:
        people = _feasible_people(config.seed, max(pairs.values()), config.patient)
    else:
        people = np.array([config.person])
        if not _draw_people(config.seed, people, config.patient).feasible.all():
            raise Refusal(
                f"no basal rate holds person {config.person} of seed {config.seed} at the setpoint; give another person"
            )
    for position, (name, number) in enumerate(pairs.items()):
        bare_is_done = 2 * position < done
        if 2 * position + 1 < done:
            continue
        person, order, trial = people[:number], _order(config.seed, name), _trial_of(config, name)
        bare = catalogue_controller(name, config.patient)
        loops = _WatchedLoops(trial, bare, order)
        # each person's time below 60 mg/dl is needed again for the effect of the guard
        without = loops.close(person, _uncounted if bare_is_done else progress)
        if not bare_is_done:
            yield {"arm": _arm(config, name, loops, person, without, guarded=False)}
        loops = _WatchedLoops(trial, with_guard(bare, guard_of(trial.patient), trial.limits), order)
        closed = loops.close(person, progress)
        yield {
            "arm": _arm(config, name, loops, person, closed, guarded=True),
            "guarding": {"controller": name, **_guarding(person, without.below_60_pct, closed.below_60_pct)},
        }


def _uncounted(loops: int) -> None:
    """Count no loops, since they were closed and counted before."""


def _arm(
    config: Verification, name: str, loops: _WatchedLoops, person: Numbers, closed: _Closed, *, guarded: bool
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
        "examples": [
            {
                "promise": promise,
                "person": (number := int(person[i])),
                "samples": int(closed.broken[place, i]),
                "first_min": float(closed.first_min[place, i]),
                "faults": circumstances_of(name, config.seed, number, config.patient)["faults"],
                "repeat": config.repeat(name, number),
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
