"""Random faults for many people: up to three at once of every kind, absurd ones among them.

All faults wrap one sensor and one pump, and each person has individual numbers, by which only the person's own faults
ever begin: so a loop is compiled once for all people. The faults of a person are a function of the seed and the
person's number alone.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.episodes import Episodes
from glucoloop.experiments.faulty import put_around
from glucoloop.parts.faults import DURATION, FAULTS, KEY, PER_DAY, START, FaultPart
from glucoloop.parts.setting import Value
from glucoloop.pumps import DoseLimits, LimitedPump, Pump
from glucoloop.sensors import IdealSensor, Sensor, WhiteNoise
from glucoloop.threefry import uniforms
from glucoloop.units import MIN_PER_DAY

Floats = npt.NDArray[np.float64]

MOST_AT_ONCE: Final = 3
SAMPLE_MIN: Final = 5.0
LONGEST_SAMPLES: Final = 48

_TO_THE_END: Final = 0.15
"""Share of the planned faults that last to the end."""
_RECURS: Final = 0.3

SENSOR_KINDS: Final = tuple(entry.name for entry in FAULTS.values() if entry.part == "sensor")
PUMP_KINDS: Final = tuple(
    kind
    for entry in FAULTS.values()
    if entry.part == "pump"
    for kind in ((entry.name,) if entry.both is None else (entry.name, f"{entry.name}, {entry.both}"))
)
"""Kinds of pump faults, from the inside out."""
KINDS: Final = (*SENSOR_KINDS, *PUMP_KINDS)


@dataclass(frozen=True)
class Order:
    """Common part of the faults of a controller's people: their order, and the length of buffers."""

    sensor: tuple[str, ...]
    """Kinds of sensor faults from the inside out."""
    shared: Mapping[str, Mapping[str, Value]]
    """Values of settings that all people share, by kind."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of sensor and pump faults, in the order in which they wrap each other."""
        return (*self.sensor, *PUMP_KINDS)


def random_order(seed: int, number: int) -> Order:
    """Order of faults with the given number."""
    score = [float(uniforms(seed, f"order of {kind}", [number])[0]) for kind in SENSOR_KINDS]

    def whole(name: str, least: int, most: int) -> int:
        return least + int((most - least + 1) * uniforms(seed, name, [number])[0])

    return Order(
        sensor=tuple(kind for _, kind in sorted(zip(score, SENSOR_KINDS, strict=True))),
        shared={kind: {name: draw(whole) for name, draw in _entry(kind).shared.items()} for kind in KINDS},
    )


@dataclass(frozen=True)
class RandomFaults:
    """Faults of people and their sizes; ``(n,)`` each."""

    order: Order
    there: Mapping[str, npt.NDArray[np.bool_]]
    """Whether each person has a fault, by kind."""
    settings: Mapping[str, Mapping[str, Floats]]
    """Values of the settings of each kind, in the unit of the setting."""
    earliest: Mapping[str, Floats]
    """First sample of each kind; infinite for a fault that never begins or begins at random."""
    length: Mapping[str, Floats]
    """Number of samples of each kind."""
    probability: Mapping[str, Floats]
    noise_variance: Floats
    noise_bound_mg_dl: Floats

    def sensor(self, *, person: int | None = None) -> Sensor:
        """Sensors of all people, or of one."""
        sensor: Sensor = WhiteNoise(
            inner=IdealSensor(),
            variance=_of(self.noise_variance, person),
            bound_mg_dl=_of(self.noise_bound_mg_dl, person),
        )
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
        usual = put_around(inner, entry(**self._shared(kind)), SAMPLE_MIN, limits)
        values: dict[str, Any] = {name: _of(many, person) for name, many in self.settings[kind].items()}
        if entry.idle:
            there = _of(self.there[kind], person)
            values = {name: jnp.where(there, value, entry.idle[name]) for name, value in values.items()}
        own = usual.numbers(values, SAMPLE_MIN) if hasattr(usual, "numbers") else values
        if hasattr(usual, "episodes"):
            own = {**own, "episodes": self._episodes(kind, person)}
        return dataclasses.replace(usual, **own)

    def _shared(self, kind: str) -> dict[str, Value]:
        """Settings of a kind that all people share."""
        both = _entry(kind).both
        noticed = {both: True} if both is not None and kind.endswith(f", {both}") else {}
        return {**noticed, **self.order.shared[kind]}

    def texts(self, person: int) -> list[str]:
        """Faults of one person in the form of `glucoloop run --fault`, in the order in which they wrap each other."""
        return [self._text(kind, person) for kind in self.order.kinds if self.there[kind][person]]

    def _episodes(self, kind: str, person: int | None) -> Episodes:
        first = _of(self.earliest[kind], person)
        return Episodes(
            earliest=first,
            latest=first,
            length=_of(self.length[kind], person),
            probability=_of(self.probability[kind], person),
            random=True,
            key=_key(kind),
        )

    def _text(self, kind: str, person: int) -> str:
        entry, given = _entry(kind), {KEY: _key(kind), **self._shared(kind)}
        for setting, values in self.settings[kind].items():
            value = float(values[person])
            given[setting] = int(value) if entry.settings()[setting].kind is int else value
        often, lasts = float(self.probability[kind][person]), float(self.length[kind][person])
        if entry.each_sample is not None:
            given[entry.each_sample] = often
        elif entry.timed:
            if often > 0.0:
                given[PER_DAY] = often * (MIN_PER_DAY / SAMPLE_MIN)
            else:
                given[START] = float(self.earliest[kind][person]) * SAMPLE_MIN
            if math.isfinite(lasts):
                given[DURATION] = lasts * SAMPLE_MIN
        return entry(**given).text


def random_faults(order: Order, seed: int, person: npt.ArrayLike, samples: int) -> RandomFaults:
    """Faults of some persons in a run of so many samples."""
    people = np.asarray(person, np.int64)

    def drawn(name: str, index: int = 0) -> Floats:
        return uniforms(seed, f"fault {name}", people, index)

    many = np.floor((MOST_AT_ONCE + 1) * drawn("how many"))
    rank = np.argsort(np.argsort([drawn(f"which {kind}") for kind in KINDS], axis=0), axis=0)
    there = {kind: rank[place] < many for place, kind in enumerate(KINDS)}
    earliest, length, probability = {}, {}, {}
    for kind in KINDS:
        recurs = there[kind] & (drawn(f"by chance {kind}") < _RECURS)
        lasts = 1.0 + np.floor(LONGEST_SAMPLES * drawn(f"length {kind}"))
        # half of those that come again and again last one sample
        lasts = np.where(recurs & (drawn(f"single {kind}") < 0.5), 1.0, lasts)
        endless = ~recurs & (drawn(f"endless {kind}") < _TO_THE_END)
        often = 2.0 ** -np.floor(2.0 + 6.0 * drawn(f"often {kind}"))
        first = np.floor(samples * drawn(f"onset {kind}"))
        if _entry(kind).each_sample is not None:
            recurs, lasts, endless, often = there[kind], np.ones(people.size), ~there[kind], drawn("share")
        earliest[kind] = np.where(there[kind] & ~recurs, first, np.inf)
        length[kind] = np.where(endless, np.inf, lasts)
        probability[kind] = np.where(recurs, often, 0.0)
    return RandomFaults(
        order=order,
        there=there,
        settings={kind: _settings(kind, drawn) for kind in KINDS},
        earliest=earliest,
        length=length,
        probability=probability,
        noise_variance=np.where(drawn("noise") < 0.3, 0.0, 25.0 * drawn("noise variance") ** 2),
        noise_bound_mg_dl=3.0 + 27.0 * drawn("noise bound"),
    )


def _settings(kind: str, drawn: Callable[..., Floats]) -> dict[str, Floats]:
    """Settings of a fault that are drawn for each person."""

    def even(low: float, high: float, index: int = 0) -> Floats:
        return low + (high - low) * drawn(f"size {kind}", index)

    return {name: np.asarray(draw(even)) for name, draw in _entry(kind).drawn.items()}


def _entry(kind: str) -> type[FaultPart]:
    return FAULTS[kind.partition(", ")[0]]


def _key(kind: str) -> int:
    """Number that makes the random draws of each kind differ."""
    return KINDS.index(kind) + 1


def _of(values: Any, person: int | None) -> Any:
    return values if person is None else values[person]
