"""Catalogue of faults: description, settings, and place of the implementation.

A fault joins the command line, the configuration files, the stress test and the random faults of ``glucoloop verify``
by one entry in `FAULTS`; one of another package, by an entry point in the group ``glucoloop.faults``, joins all but the
last. Nothing here imports a numerical library, so that help is shown at once.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from glucoloop.plausible import GLUCOSE_BOUND, RATE_STEP
from glucoloop.registry.plugins import added, added_names, loaded
from glucoloop.registry.settings import Default, Setting, Value, known_names

START: Final = "start_min"
LATEST: Final = "latest_min"
DURATION: Final = "duration_min"
PER_DAY: Final = "per_day"
KEY: Final = "key"

TIMING: Final = (
    Setting(START, float, "Time at which the fault begins, rounded up to a sample.", Default(0.0)),
    Setting(LATEST, float, "Latest start; the start is drawn between start_min and it, for each person.", Default(0.0)),
    Setting(DURATION, float, "Duration of the fault; by default to the end, or one sample with per_day.", Default(0.0)),
    Setting(PER_DAY, float, "Mean number of random occurrences in a day, in place of a start.", Default(0.0)),
)
"""Settings of the times of a fault, which have no value unless one is given."""
OWN_KEY: Final = Setting(
    KEY, int, "Number that makes the random draws of two faults of the same kind differ.", Default(0)
)


Draw = Callable[[Callable[..., Any]], dict[str, Any]]
"""Function that returns values ``(people,)`` by setting. It is given ``even(low, high, index=0)``, which draws
evenly distributed numbers; a setting that needs a second number gives it another index."""
Shared = Callable[[Callable[[str, int, int], int]], dict[str, Any]]
"""Function that returns values by setting. It is given a function ``whole(name, least, most)``, which draws a whole
number."""


@dataclass(frozen=True)
class FaultEntry:
    """A fault of the catalogue."""

    name: str
    part: Literal["sensor", "pump"]
    summary: str
    make: str
    """``module:function`` that puts the fault around a sensor or a pump.

    It is called by name with the settings of the fault and, if it has parameters of these names, with ``inner``,
    ``episodes``, ``sample_time_min``, ``limits`` and ``key``. It returns a record whose field ``inner`` is the part.
    """
    settings: tuple[Setting, ...] = ()
    timed: bool = True
    """Whether the fault has times; otherwise it is always present."""
    comes_and_goes: bool = True
    """Whether there are times without the fault."""
    draw: Draw | None = None
    """Values of its settings for random people, see `Draw`; settings that are not drawn have their defaults."""
    shared: Shared | None = None
    """Values of the settings that all people of a compiled loop share."""
    idle: Mapping[str, float] = field(default_factory=dict)
    """Values with which a fault that is always present changes nothing."""
    each_sample: str | None = None
    """Setting that is the probability of the fault in each sample."""
    both: str | None = None
    """Setting, true or false, of which either value is drawn as a kind of its own."""

    def __post_init__(self) -> None:
        if not all(self.make.partition(":")):
            raise ValueError(f"{self.make!r} of the fault {self.name} is no place; write it like module:function")

    def maker(self) -> Callable[..., Any]:
        """The function that puts the fault around a part; importing it imports JAX.

        Raises
        ------
        ValueError
            If there is no such function.
        """
        maker: Callable[..., Any] = loaded(self.make)
        return maker

    @property
    def all_settings(self) -> dict[str, Setting]:
        """Settings of the fault itself, and those of its times."""
        every = (*(TIMING if self.timed else ()), *self.settings, OWN_KEY)
        return {setting.name: setting for setting in every}


@dataclass(frozen=True)
class Fault:
    """A fault with its settings: the given ones, and defaults for the fault's own."""

    name: str
    settings: Mapping[str, Value]

    @property
    def entry(self) -> FaultEntry:
        """Entry of the fault in the catalogue."""
        return fault_entry(self.name)


_NOTICED: Final = Setting("noticed", bool, "Whether the pump reports the fault: true or false.", Default(False))

_NONSENSE: Final = (math.nan, math.inf, -math.inf, 0.0, 2000.0, 1e300, -1e300, -40.0, 600.0, 20.0)
_SENSORS: Final = "glucoloop.sensors.faults"
_PUMPS: Final = "glucoloop.pumps.faults"
_NO_STEP: Final = 2.0**-1000
"""A resolution by which no dose is changed: to divide by a power of two is exact."""


def _range(even: Callable[..., Any]) -> dict[str, Any]:
    low = even(0.0, 150.0)
    return {"low_mg_dl": low, "high_mg_dl": low + even(1.0, 300.0, 1)}


def _steps(even: Callable[..., Any]) -> dict[str, Any]:
    step = 2.0 ** (even(-4.0, 4.0) // 1.0)
    return {"step_mU_min": step, "least_mU_min": step * (even(0.0, 4.0, 1) // 1.0)}


FAULTS: Final[dict[str, FaultEntry]] = {
    entry.name: entry
    for entry in (
        FaultEntry("missing", "sensor", "readings do not arrive", f"{_SENSORS}:missing"),
        FaultEntry(
            "late",
            "sensor",
            "readings arrive late and do not say so",
            f"{_SENSORS}:late_by",
            (Setting("delay_min", float, "Delay of the readings, rounded up to samples.", Default(15.0)),),
            shared=lambda whole: {"delay_min": 5.0 * whole("delay", 1, 12)},
        ),
        FaultEntry(
            "repeated",
            "sensor",
            "each reading is given several times",
            f"{_SENSORS}:repeated",
            (Setting("times", int, "Number of times that each reading is given.", Default(3)),),
            draw=lambda even: {"times": even(2.0, 13.0) // 1.0},
        ),
        FaultEntry(
            "out-of-order",
            "sensor",
            "a random one of the latest readings is given",
            f"{_SENSORS}:out_of_order",
            (Setting("among", int, "Number of latest readings among which one is drawn.", Default(4)),),
            shared=lambda whole: {"among": whole("among", 2, 8)},
        ),
        FaultEntry(
            "spikes",
            "sensor",
            "readings are off by a fixed amount",
            f"{_SENSORS}:spikes",
            (Setting("size_mg_dl", float, "Error of the readings, of either sign.", Default(60.0)),),
            draw=lambda even: {"size_mg_dl": even(-1000.0, 1000.0)},
        ),
        FaultEntry("stuck", "sensor", "the reading at the start of the fault is repeated", f"{_SENSORS}:stuck"),
        FaultEntry(
            "drift",
            "sensor",
            "readings have an error that grows with time",
            f"{_SENSORS}:drift",
            (Setting("mg_dl_h", float, "Growth of the error in an hour, of either sign.", Default(5.0)),),
            draw=lambda even: {"mg_dl_h": even(-1.0, 1.0) * 10.0 ** even(0.0, 3.0, 1)},
        ),
        FaultEntry(
            "calibration",
            "sensor",
            "readings are wrong by a gain and an offset",
            f"{_SENSORS}:calibration",
            (
                Setting("gain", float, "Factor from the correct reading to the given one.", Default(1.15)),
                Setting("offset_mg_dl", float, "Offset that is added after the gain.", Default(0.0)),
            ),
            draw=lambda even: {"gain": 10.0 ** even(-1.0, 1.0), "offset_mg_dl": even(-200.0, 200.0, 1)},
        ),
        FaultEntry(
            "compression",
            "sensor",
            "readings fall because someone lies on the sensor",
            f"{_SENSORS}:compression",
            (
                Setting("depth", float, "Part of the reading that is finally lost.", Default(0.3)),
                Setting("tau_min", float, "Time constant of fall and recovery.", Default(10.0)),
            ),
            draw=lambda even: {"depth": even(0.05, 1.0), "tau_min": even(1.0, 60.0, 1)},
        ),
        FaultEntry(
            "saturation",
            "sensor",
            "readings are limited to a range",
            f"{_SENSORS}:saturation",
            (
                Setting("low_mg_dl", float, "Lower end of the range.", Default(40.0), quantity=GLUCOSE_BOUND),
                Setting("high_mg_dl", float, "Upper end of the range.", Default(400.0), quantity=GLUCOSE_BOUND),
            ),
            draw=_range,
        ),
        FaultEntry(
            "nonsense",
            "sensor",
            "a fixed number is given as a valid reading: nan, inf, 0, 2000",
            f"{_SENSORS}:nonsense",
            (Setting("value", float, "Number that is given.", Default(0.0)),),
            draw=lambda even: {"value": [_NONSENSE[int(place)] for place in even(0.0, float(len(_NONSENSE)))]},
        ),
        # Pumps' faults from the inside out, as they are drawn: what is around a pump without power does not restart.
        FaultEntry(
            "resolution",
            "pump",
            "only whole steps are delivered, from a least dose on; the remainder is delivered later",
            "glucoloop.pumps:with_resolution",
            (
                Setting("step_mU_min", float, "Step of the rate.", Default(0.5), quantity=RATE_STEP),
                Setting("least_mU_min", float, "Least rate that is delivered.", Default(0.0)),
            ),
            timed=False,
            comes_and_goes=False,
            draw=_steps,
            idle={"step_mU_min": _NO_STEP, "least_mU_min": 0.0},
        ),
        FaultEntry(
            "battery",
            "pump",
            "the pump is off, reports nothing, and starts again from rest",
            f"{_PUMPS}:battery_gap",
        ),
        FaultEntry(
            "missed-pulses",
            "pump",
            "single doses at random are not delivered",
            f"{_PUMPS}:missed_pulses",
            (Setting("share", float, "Share of the doses that are missed.", Default(0.2)), _NOTICED),
            timed=False,
            each_sample="share",
        ),
        FaultEntry(
            "occlusion",
            "pump",
            "less insulin passes the line than the pump drives",
            f"{_PUMPS}:occlusion",
            (Setting("open_fraction", float, "Part of the insulin that is delivered.", Default(0.0)), _NOTICED),
            draw=lambda even: {"open_fraction": (even(0.0, 1.0) >= 0.5) * even(0.0, 0.95, 1)},
            both="noticed",
        ),
        FaultEntry(
            "unheard",
            "pump",
            "commands do not reach the pump, which goes to its least rate",
            f"{_PUMPS}:unheard",
        ),
    )
}


@functools.cache
def fault_entry(name: str) -> FaultEntry:
    """A fault of the catalogue by name: of this package, of another one, or ``module:attribute``.

    Raises
    ------
    ValueError
        For an unknown name, or a fault of another package that cannot be loaded.
    """
    if name in FAULTS:
        return FAULTS[name]
    entry: FaultEntry | None = added("faults", name, FaultEntry)
    if entry is None:
        raise ValueError(f"unknown fault {name!r}; {known_names(name, fault_names())}")
    return entry


def fault_names() -> list[str]:
    """Names of all faults, those of other packages included."""
    return [*FAULTS, *added_names("faults")]


def fault(name: str, given: Mapping[str, object] | None = None) -> Fault:
    """A fault by name.

    Raises
    ------
    ValueError
        For an unknown fault or setting, a value of the wrong type, or times that exclude one another.
    """
    entry, given = fault_entry(name), given or {}
    settings = entry.all_settings
    for key in given:
        if key not in settings:
            raise ValueError(f"the fault {name} has no setting {key!r}; {known_names(key, settings)}")
    checked = {key: settings[key].check(value) for key, value in given.items()}
    _check_times(name, checked)
    own = {setting.name: checked.get(setting.name, setting.default.noise_free) for setting in entry.settings}
    when = {setting.name: checked[setting.name] for setting in (*TIMING, OWN_KEY) if setting.name in checked}
    return Fault(name=name, settings={**when, **own})


def _check_times(name: str, given: Mapping[str, Value]) -> None:
    for key in (START, LATEST, DURATION, PER_DAY):
        value = float(given.get(key, 0.0))
        least = "above 0" if key in (DURATION, PER_DAY) and key in given else "of 0 or more"
        if not (0.0 <= value < float("inf")) or (least == "above 0" and value == 0.0):
            raise ValueError(f"{key} of the fault {name} is {value:g}; give a finite value {least}")
    if PER_DAY in given and (START in given or LATEST in given):
        other = START if START in given else LATEST
        raise ValueError(
            f"the fault {name} has both {PER_DAY} and {other}; it is either random or planned, leave one out"
        )
    if float(given.get(LATEST, float("inf"))) < float(given.get(START, 0.0)):
        raise ValueError(
            f"the fault {name} is to begin from {given[START]:g} to {given[LATEST]:g} min; "
            f"give a {LATEST} of {given[START]:g} or more"
        )
