"""Faults of sensors and pumps: name and settings of each, and the place of the function that puts it around one.

A fault joins every command, the stress test and the random faults of ``glucoloop verify`` by one class, entered in
`FAULTS`; one of another package, by an entry point in the group ``glucoloop.faults``, joins all but the last.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Final, Literal

from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import READINGS, Need
from glucoloop.component.part import MadePart
from glucoloop.component.setting import About, Setting
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import GLUCOSE_BOUND, RATE_STEP

START: Final = "start_min"
LATEST: Final = "latest_min"
DURATION: Final = "duration_min"
PER_DAY: Final = "per_day"
KEY: Final = "key"
TIMING: Final = (START, LATEST, DURATION, PER_DAY)
"""Settings of the times of a fault, which have no value unless one is given."""

Even = Callable[..., Any]
"""Function ``even(low, high, index=0)`` that draws evenly distributed numbers ``(people,)``; a second number of a fault
has another index."""
Whole = Callable[[str, int, int], int]
"""Function ``whole(name, least, most)`` that draws a whole number for all people of a compiled loop."""
Key = Annotated[
    int | None, About("Number that makes the random draws of two faults of the same kind differ; 0 by default.")
]
Step = Annotated[float, About("Step of the rate.", above=0.0, quantity=RATE_STEP)]
Least = Annotated[float, About("Least rate that is delivered.", at_least=0.0)]
Noticed = Annotated[bool, About("Whether the pump reports the fault: true or false.")]


class FaultPart(MadePart):
    """Declaration of a fault.

    Its function is given the settings of the fault itself, and, if it has parameters of these names, ``inner``,
    ``episodes``, ``sample_time_min``, ``limits`` and ``key``. It returns a record whose field ``inner`` is the sensor
    or pump inside. A class with times extends `Timed`, one without `Untimed`.
    """

    kind: ClassVar = "fault"
    part: ClassVar[Literal["sensor", "pump"]] = "sensor"
    timed: ClassVar[bool] = True
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

    def made(self, **known: Any) -> Any:
        """The sensor or pump with the fault."""
        return self.made_of({name: getattr(self, name) for name in self.effect_settings()}, known)


class Timed(FaultPart):
    """A fault that has times."""

    start_min: Annotated[
        float | None, About("Time at which the fault begins, rounded up to a sample.", at_least=0.0)
    ] = None
    latest_min: Annotated[
        float | None, About("Latest start; the start is drawn between start_min and it, for each person.", at_least=0.0)
    ] = None
    duration_min: Annotated[
        float | None, About("Duration of the fault; by default to the end, or one sample with per_day.", above=0.0)
    ] = None
    per_day: Annotated[
        float | None, About("Mean number of random occurrences in a day, in place of a start.", above=0.0)
    ] = None
    key: Key = None

    def __post_init__(self) -> None:
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


class Untimed(FaultPart):
    """A fault that is always present."""

    timed: ClassVar = False
    key: Key = None


_NONSENSE: Final = (math.nan, math.inf, -math.inf, 0.0, 2000.0, 1e300, -1e300, -40.0, 600.0, 20.0)
_SENSORS: Final = "glucoloop.sensors.faults"
_PUMPS: Final = "glucoloop.pumps.faults"
_NO_STEP: Final = 2.0**-1000
"""A resolution by which no dose is changed: to divide by a power of two is exact."""


class MissingSettings(Timed, name="missing"):
    """Readings do not arrive."""

    make: ClassVar = f"{_SENSORS}:missing"


class LateSettings(Timed, name="late"):
    """Readings arrive late and do not say so."""

    make: ClassVar = f"{_SENSORS}:late_by"
    delay_min: Annotated[float, About("Delay of the readings, rounded up to samples.", above=0.0)] = 15.0
    shared: ClassVar = {"delay_min": lambda whole: 5.0 * whole("delay", 1, 12)}


class RepeatedSettings(Timed, name="repeated"):
    """Each reading is given several times."""

    make: ClassVar = f"{_SENSORS}:repeated"
    times: Annotated[int, About("Number of times that each reading is given.", at_least=2)] = 3
    drawn: ClassVar = {"times": lambda even: even(2.0, 13.0) // 1.0}


class OutOfOrderSettings(Timed, name="out-of-order"):
    """A random one of the latest readings is given."""

    make: ClassVar = f"{_SENSORS}:out_of_order"
    among: Annotated[int, About("Number of latest readings among which one is drawn.", at_least=2, at_most=48)] = 4
    shared: ClassVar = {"among": lambda whole: whole("among", 2, 8)}


class SpikesSettings(Timed, name="spikes"):
    """Readings are off by a fixed amount."""

    make: ClassVar = f"{_SENSORS}:spikes"
    size_mg_dl: Annotated[float, About("Error of the readings, of either sign.")] = 60.0
    drawn: ClassVar = {"size_mg_dl": lambda even: even(-1000.0, 1000.0)}


class StuckSettings(Timed, name="stuck"):
    """The reading at the start of the fault is repeated."""

    make: ClassVar = f"{_SENSORS}:stuck"


class DriftSettings(Timed, name="drift"):
    """Readings have an error that grows with time."""

    make: ClassVar = f"{_SENSORS}:drift"
    mg_dl_h: Annotated[float, About("Growth of the error in an hour, of either sign.", unit="mg/dl per hour")] = 5.0
    drawn: ClassVar = {"mg_dl_h": lambda even: even(-1.0, 1.0) * 10.0 ** even(0.0, 3.0, 1)}


class CalibrationSettings(Timed, name="calibration"):
    """Readings are wrong by a gain and an offset."""

    make: ClassVar = f"{_SENSORS}:calibration"
    gain: Annotated[float, About("Factor from the correct reading to the given one.", above=0.0)] = 1.15
    offset_mg_dl: Annotated[float, About("Offset that is added after the gain.")] = 0.0
    drawn: ClassVar = {
        "gain": lambda even: 10.0 ** even(-1.0, 1.0),
        "offset_mg_dl": lambda even: even(-200.0, 200.0, 1),
    }


class CompressionSettings(Timed, name="compression"):
    """Readings fall because someone lies on the sensor."""

    sources = ("facchinetti2016",)
    make: ClassVar = f"{_SENSORS}:compression"
    depth: Annotated[float, About("Part of the reading that is finally lost.", above=0.0, at_most=1.0)] = 0.3
    tau_min: Annotated[float, About("Time constant of fall and recovery.", above=0.0)] = 10.0
    drawn: ClassVar = {"depth": lambda even: even(0.05, 1.0), "tau_min": lambda even: even(1.0, 60.0, 1)}


class SaturationSettings(Timed, name="saturation"):
    """Readings are limited to a range."""

    make: ClassVar = f"{_SENSORS}:saturation"
    low_mg_dl: Annotated[float, About("Lower end of the range.", at_least=0.0, quantity=GLUCOSE_BOUND)] = 40.0
    high_mg_dl: Annotated[float, About("Upper end of the range.", above=0.0, quantity=GLUCOSE_BOUND)] = 400.0
    drawn: ClassVar = {
        "low_mg_dl": lambda even: even(0.0, 150.0),
        "high_mg_dl": lambda even: even(0.0, 150.0) + even(1.0, 300.0, 1),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low_mg_dl < self.high_mg_dl:
            raise Refusal(
                f"a sensor range of {self.low_mg_dl:g} to {self.high_mg_dl:g} mg/dl is not possible; "
                "give an upper end above the lower one"
            )


class NonsenseSettings(Timed, name="nonsense"):
    """A fixed number is given as a valid reading: nan, inf, 0, 2000."""

    make: ClassVar = f"{_SENSORS}:nonsense"
    value: Annotated[float, About("Number that is given.", finite=False)] = 0.0
    drawn: ClassVar = {"value": lambda even: [_NONSENSE[int(place)] for place in even(0.0, float(len(_NONSENSE)))]}


class ResolutionSettings(Untimed, name="resolution"):
    """Whole steps alone are delivered, from a least dose on; the remainder is delivered later."""

    make: ClassVar = "glucoloop.pumps:with_resolution"
    part: ClassVar = "pump"
    comes_and_goes: ClassVar = False
    idle: ClassVar = {"step_mU_min": _NO_STEP, "least_mU_min": 0.0}
    step_mU_min: Step = 0.5
    least_mU_min: Least = 0.0
    drawn: ClassVar = {
        "step_mU_min": lambda even: 2.0 ** (even(-4.0, 4.0) // 1.0),
        "least_mU_min": lambda even: 2.0 ** (even(-4.0, 4.0) // 1.0) * (even(0.0, 4.0, 1) // 1.0),
    }


class BatterySettings(Timed, name="battery"):
    """The pump is off, reports nothing, and starts again from rest."""

    make: ClassVar = f"{_PUMPS}:battery_gap"
    part: ClassVar = "pump"


class MissedPulsesSettings(Untimed, name="missed-pulses"):
    """Single doses at random are not delivered."""

    make: ClassVar = f"{_PUMPS}:missed_pulses"
    part: ClassVar = "pump"
    each_sample: ClassVar = "share"
    share: Annotated[float, About("Share of the doses that are missed.", at_least=0.0, at_most=1.0)] = 0.2
    noticed: Noticed = False


class OcclusionSettings(Timed, name="occlusion"):
    """Less insulin passes the line than the pump drives."""

    make: ClassVar = f"{_PUMPS}:occlusion"
    part: ClassVar = "pump"
    both: ClassVar = "noticed"
    open_fraction: Annotated[float, About("Part of the insulin that is delivered.", at_least=0.0, below=1.0)] = 0.0
    noticed: Noticed = False
    drawn: ClassVar = {"open_fraction": lambda even: (even(0.0, 1.0) >= 0.5) * even(0.0, 0.95, 1)}


class UnheardSettings(Timed, name="unheard"):
    """Commands do not reach the pump, which goes to its least rate."""

    make: ClassVar = f"{_PUMPS}:unheard"
    part: ClassVar = "pump"


_Part = functools.partial(About, at_least=0.0, at_most=10.0)


class MisreportedSettings(Timed, name="misreported"):
    """The pump gives what it is asked for and reports a part of it, a multiple, or the dose of the sample before."""

    make: ClassVar = f"{_PUMPS}:misreported"
    part: ClassVar = "pump"
    rate_part: Annotated[float, _Part("Part of the basal rate that is reported; 2 for twice as much.")] = 0.0
    bolus_part: Annotated[float, _Part("Part of a bolus that is reported; 2 for twice as much.")] = 0.0
    late_samples: Annotated[int, About("Samples by which the report is late, 0 or 1.", at_least=0, at_most=1)] = 0
    drawn: ClassVar = {
        "rate_part": lambda even: (even(0.0, 1.0) >= 0.3) * even(0.0, 2.0, 1),
        "bolus_part": lambda even: (even(0.0, 1.0, 2) >= 0.3) * even(0.0, 2.0, 3),
        "late_samples": lambda even: even(0.0, 2.0, 4) // 1.0,
    }


FAULTS: Final = Catalogue(
    FaultPart,
    (
        MissingSettings,
        LateSettings,
        RepeatedSettings,
        OutOfOrderSettings,
        SpikesSettings,
        StuckSettings,
        DriftSettings,
        CalibrationSettings,
        CompressionSettings,
        SaturationSettings,
        NonsenseSettings,
        # Pumps' faults from the inside out, as they are drawn: what is around a pump without power does not restart.
        ResolutionSettings,
        BatterySettings,
        MissedPulsesSettings,
        OcclusionSettings,
        UnheardSettings,
        MisreportedSettings,
    ),
    example="missing, start_min=120, duration_min=30",
)
