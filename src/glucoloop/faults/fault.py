"""Common part of all faults: whether one is of a sensor or of a pump, its times, and how it is drawn at random."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY
from typing import Annotated, Any, ClassVar, Final, Literal

from glucoloop._pytree import pytree
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import READINGS, Need
from glucoloop.component.pytree_component import HOST, PytreeComponent, derived, wired
from glucoloop.component.setting import About, Setting
from glucoloop.faults.schedule import Episode, Episodes, always, once, recurring
from glucoloop.refusal import Refusal
from glucoloop.sensors.protocol import checked_sample_time
from glucoloop.units import MIN_PER_DAY

START: Final = "start_min"
LATEST: Final = "latest_min"
DURATION: Final = "duration_min"
PER_DAY: Final = "per_day"
KEY: Final = "key"
TIMING: Final = (START, LATEST, DURATION, PER_DAY)
"""Settings of the times of a fault, which have no value unless one is given."""
_HAIR: Final = 1e-9  # of a sample: whole minutes over whole minutes may come out just above a whole number

Even = Callable[..., Any]
"""Function ``even(low, high, index=0)`` that draws evenly distributed numbers ``(people,)``; a second number of a fault
has another index."""
Whole = Callable[[str, int, int], int]
"""Function ``whole(name, minimum, maximum)`` that draws a whole number for all people of a compiled loop."""
Key = Annotated[
    int | None, About("Number that makes the random draws of two faults of the same kind differ; 0 by default."), HOST
]


@pytree
class FaultState:
    """State of the inner sensor or pump, of the times of the fault, and of the fault itself."""

    inner: Any
    episode: Episode
    memory: Any


class FaultComponent(PytreeComponent):
    """A fault around a sensor or a pump, its ``inner``. One that has times extends `Timed`."""

    kind: ClassVar = "fault"
    part: ClassVar[Literal["sensor", "pump"]] = "sensor"
    timed: ClassVar[bool] = False
    """Whether the fault has times; otherwise it is always present."""
    comes_and_goes: ClassVar[bool] = True
    """Whether there are times without the fault."""
    idle: ClassVar[Mapping[str, float]] = {}
    """Values with which a fault that is always present changes nothing."""
    each_sample: ClassVar[str | None] = None
    """Setting that is the probability of the fault in each sample."""
    both: ClassVar[str | None] = None
    """Setting, true or false, of which either value is drawn as a kind of its own."""

    drawn: ClassVar[Mapping[str, Callable[[Even], Any]]] = {}
    """Functions that draw values ``(people,)`` of settings for random people; the others have their defaults."""
    shared: ClassVar[Mapping[str, Callable[[Whole], Any]]] = {}
    """Functions that draw values of settings that all people of a compiled loop share."""

    _: KW_ONLY
    sample_time_min: float = wired(HOST, default=5.0)

    def __post_init__(self) -> None:
        checked_sample_time(self.sample_time_min)

    def needs(self) -> tuple[Need, ...]:
        """A fault of the sensor has an effect where something uses its readings."""
        return (READINGS,) if self.part == "sensor" else ()

    @classmethod
    def effect_settings(cls) -> dict[str, Setting]:
        """Settings of the fault itself, without those of its times and draws."""
        return {name: setting for name, setting in cls.settings().items() if name not in (*TIMING, KEY)}

    def values(self) -> dict[str, Any]:
        """Settings with their values; times that were not given are left out."""
        return {name: value for name, value in super().values().items() if value is not None}


FAULTS: Final = Catalogue(
    FaultComponent,
    {
        "missing": "glucoloop.faults.sensor:Missing",
        "late": "glucoloop.faults.sensor:Late",
        "repeated": "glucoloop.faults.sensor:Repeated",
        "out-of-order": "glucoloop.faults.sensor:OutOfOrder",
        "spikes": "glucoloop.faults.sensor:Spikes",
        "stuck": "glucoloop.faults.sensor:Stuck",
        "drift": "glucoloop.faults.sensor:Drift",
        "calibration": "glucoloop.faults.sensor:Calibration",
        "compression": "glucoloop.faults.sensor:Compression",
        "saturation": "glucoloop.faults.sensor:Saturation",
        "nonsense": "glucoloop.faults.sensor:Nonsense",
        "resolution": "glucoloop.faults.pump:CoarseDelivery",
        "battery": "glucoloop.faults.pump:Battery",
        "missed-pulses": "glucoloop.faults.pump:MissedPulses",
        "occlusion": "glucoloop.faults.pump:Occlusion",
        "unheard": "glucoloop.faults.pump:Unheard",
        "misreported": "glucoloop.faults.pump:Misreported",
    },
    example="missing, start_min=120, duration_min=30",
)


class Untimed(FaultComponent):
    """A fault without times of its own."""

    _: KW_ONLY
    key: Key = None


class Timed(FaultComponent):
    """A fault that has times: settings in minutes, or a `schedule` in samples; without either it is always present."""

    timed: ClassVar = True

    _: KW_ONLY
    start_min: Annotated[
        float | None, About("Time at which the fault begins, rounded up to a sample.", at_least=0.0), HOST
    ] = None
    latest_min: Annotated[
        float | None,
        About("Latest start; the start is drawn between start_min and it, for each person.", at_least=0.0),
        HOST,
    ] = None
    duration_min: Annotated[
        float | None,
        About("Duration of the fault; by default to the end, or one sample with per_day.", above=0.0),
        HOST,
    ] = None
    per_day: Annotated[
        float | None, About("Mean number of random occurrences in a day, in place of a start.", above=0.0), HOST
    ] = None
    key: Key = None
    schedule: Episodes | None = wired(HOST, default=None)
    warm_up_min: float = wired(HOST, default=0.0)
    """Time before minute 0 of the settings."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.per_day is not None and (self.start_min is not None or self.latest_min is not None):
            other = START if self.start_min is not None else LATEST
            raise Refusal(
                f"the fault {self.name} has both {PER_DAY} and {other}; it is either random or planned, leave one out"
            )
        if self.latest_min is not None and self.latest_min < (self.start_min or 0.0):
            raise Refusal(
                f"the fault {self.name} is to begin from {self.start_min:g} to {self.latest_min:g} min; "
                f"give a {LATEST} of {self.start_min:g} or more"
            )
        times = [name for name in TIMING if getattr(self, name) is not None]
        if self.schedule is not None and times:
            raise Refusal(f"the fault {self.name} has both a schedule and {times[0]}; leave one out")

    @derived
    def episodes(self) -> Episodes:
        """Times at which the fault is present; planned ones count from the end of the warm-up."""
        if self.schedule is not None:
            return self.schedule
        key = self.key or 0
        lasting = math.inf if self.duration_min is None else max(1, self._samples(self.duration_min))
        if self.per_day is not None:
            probability = self.per_day * self.sample_time_min / MIN_PER_DAY
            if probability > 1.0:
                raise Refusal(
                    f"{PER_DAY} of the fault {self.name} is {self.per_day:g}; "
                    f"give at most one a sample, {MIN_PER_DAY / self.sample_time_min:g}"
                )
            return recurring(probability, 1 if self.duration_min is None else lasting, key=key)
        if self.start_min is self.latest_min is self.duration_min is None:
            return always(key=key)
        before = round(self.warm_up_min / self.sample_time_min)
        latest = None if self.latest_min is None else before + self._samples(self.latest_min)
        return once(before + self._samples(self.start_min or 0.0), lasting, latest_sample=latest, key=key)

    def _samples(self, minutes: float) -> int:
        return math.ceil(minutes / self.sample_time_min - _HAIR)
