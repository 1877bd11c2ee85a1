"""Random faults for many people: up to three at once of every kind, absurd ones among them.

All faults wrap one sensor and one pump, and each person has individual numbers, by which only the person's own faults
ever begin: so a loop is compiled once for all people. The faults of a person are a function of the seed and the
person's number alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.episodes import Episodes
from glucoloop.pumps import DoseLimits, LimitedPump, Pump, Resolution
from glucoloop.pumps.faults import BatteryGap, Occlusion
from glucoloop.registry.fault_text import fault_text
from glucoloop.registry.faults import DURATION, FAULTS, KEY, PER_DAY, START, fault
from glucoloop.sensors import IdealSensor, Sensor, WhiteNoise
from glucoloop.sensors import faults as of_sensor
from glucoloop.threefry import uniforms
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

Floats = npt.NDArray[np.float64]

MOST_AT_ONCE: Final = 3
SAMPLE_MIN: Final = 5.0
LONGEST_SAMPLES: Final = 48
DELAYS_SAMPLES: Final = (1, 12)
AMONG: Final = (2, 8)

_TO_THE_END: Final = 0.15
"""Share of the planned faults that last to the end."""
_RECURS: Final = 0.3
_NONSENSE: Final = (math.nan, math.inf, -math.inf, 0.0, 2000.0, 1e300, -1e300, -40.0, 600.0, 20.0)
_NO_STEP: Final = 2.0**-1000
"""Resolution that changes no dose, since division by a power of two is exact."""

SENSOR_KINDS: Final = (
    *("missing", "late", "repeated", "out-of-order", "spikes", "stuck"),
    *("drift", "calibration", "compression", "saturation", "nonsense"),
)
PUMP_KINDS: Final = ("resolution", "battery", "missed-pulses", "occlusion", "occlusion, noticed")
"""Kinds of pump faults from the inside out, so that faults inside a pump without power do not restart with it."""
KINDS: Final = (*SENSOR_KINDS, *PUMP_KINDS)


@dataclass(frozen=True)
class Order:
    """Common part of the faults of a controller's people: their order, and the length of buffers."""

    sensor: tuple[str, ...]
    """Kinds of sensor faults from the inside out."""
    delay_samples: int
    among: int

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
        delay_samples=whole("delay", *DELAYS_SAMPLES),
        among=whole("among", *AMONG),
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
            value = {name: _of(values, person) for name, values in self.settings[kind].items()}
            sensor = _SENSORS[kind](self.order, sensor, self._episodes(kind, person), value)
        return sensor

    def pump(self, limits: DoseLimits, *, person: int | None = None) -> Pump:
        """Pumps of all people, or of one."""
        coarse = {name: _of(values, person) for name, values in self.settings["resolution"].items()}
        is_coarse = _of(self.there["resolution"], person)
        pump: Pump = Resolution(
            inner=LimitedPump(limits=limits),
            limits=limits,
            step_mU_min=jnp.where(is_coarse, coarse["step_mU_min"], _NO_STEP),
            least_mU_min=jnp.where(is_coarse, coarse["least_mU_min"], 0.0),
        )
        pump = BatteryGap(inner=pump, episodes=self._episodes("battery", person))
        pump = Occlusion(inner=pump, episodes=self._episodes("missed-pulses", person), open_fraction=0.0)
        for kind in ("occlusion", "occlusion, noticed"):
            pump = Occlusion(
                inner=pump,
                episodes=self._episodes(kind, person),
                open_fraction=_of(self.settings[kind]["open_fraction"], person),
                noticed=kind != "occlusion",
            )
        return pump

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
        name, _, noticed = kind.partition(", ")
        given: dict[str, object] = {KEY: _key(kind)}
        if noticed:
            given["noticed"] = True
        if name == "late":
            given["delay_min"] = self.order.delay_samples * SAMPLE_MIN
        elif name == "out-of-order":
            given["among"] = self.order.among
        for setting, values in self.settings[kind].items():
            value = float(values[person])
            given[setting] = int(value) if FAULTS[name].all_settings[setting].type is int else value
        often, lasts = float(self.probability[kind][person]), float(self.length[kind][person])
        if name == "missed-pulses":
            given["share"] = often
        elif FAULTS[name].timed:
            if often > 0.0:
                given[PER_DAY] = often * (MIN_PER_DAY / SAMPLE_MIN)
            else:
                given[START] = float(self.earliest[kind][person]) * SAMPLE_MIN
            if math.isfinite(lasts):
                given[DURATION] = lasts * SAMPLE_MIN
        return fault_text(fault(name, given))


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
        if kind == "missed-pulses":
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

    if kind == "repeated":
        return {"times": np.floor(even(2.0, 13.0))}
    if kind == "spikes":
        return {"size_mg_dl": even(-1000.0, 1000.0)}
    if kind == "drift":
        return {"mg_dl_h": even(-1.0, 1.0) * 10.0 ** even(0.0, 3.0, 1)}
    if kind == "calibration":
        return {"gain": 10.0 ** even(-1.0, 1.0), "offset_mg_dl": even(-200.0, 200.0, 1)}
    if kind == "compression":
        return {"depth": even(0.05, 1.0), "tau_min": even(1.0, 60.0, 1)}
    if kind == "saturation":
        low = even(0.0, 150.0)
        return {"low_mg_dl": low, "high_mg_dl": low + even(1.0, 300.0, 1)}
    if kind == "nonsense":
        return {"value": np.asarray(_NONSENSE)[np.floor(even(0.0, float(len(_NONSENSE)))).astype(int)]}
    if kind == "resolution":
        step = 2.0 ** np.floor(even(-4.0, 4.0))
        return {"step_mU_min": step, "least_mU_min": step * np.floor(even(0.0, 4.0, 1))}
    if kind.startswith("occlusion"):
        return {"open_fraction": np.where(even(0.0, 1.0) < 0.5, 0.0, even(0.0, 0.95, 1))}
    return {}


def _key(kind: str) -> int:
    """Number that makes the random draws of each kind differ."""
    return KINDS.index(kind) + 1


def _of(values: Any, person: int | None) -> Any:
    return values if person is None else values[person]


Make = Callable[[Order, Sensor, Episodes, Mapping[str, Any]], Any]

_SENSORS: Final[dict[str, Make]] = {
    "missing": lambda order, inner, when, of: of_sensor.Missing(inner=inner, episodes=when),
    "late": lambda order, inner, when, of: of_sensor.Late(inner=inner, episodes=when, samples=order.delay_samples),
    "repeated": lambda order, inner, when, of: of_sensor.Repeated(inner=inner, episodes=when, times=of["times"]),
    "out-of-order": lambda order, inner, when, of: of_sensor.OutOfOrder(inner=inner, episodes=when, among=order.among),
    "spikes": lambda order, inner, when, of: of_sensor.Spikes(inner=inner, episodes=when, **of),
    "stuck": lambda order, inner, when, of: of_sensor.Stuck(inner=inner, episodes=when),
    "drift": lambda order, inner, when, of: of_sensor.Drift(
        inner=inner, episodes=when, mg_dl_sample=of["mg_dl_h"] * SAMPLE_MIN / MIN_PER_H
    ),
    "calibration": lambda order, inner, when, of: of_sensor.Calibration(inner=inner, episodes=when, **of),
    "compression": lambda order, inner, when, of: of_sensor.Compression(
        inner=inner, episodes=when, depth=of["depth"], left=np.exp(-SAMPLE_MIN / of["tau_min"])
    ),
    "saturation": lambda order, inner, when, of: of_sensor.Saturation(inner=inner, episodes=when, **of),
    "nonsense": lambda order, inner, when, of: of_sensor.Nonsense(inner=inner, episodes=when, **of),
}
