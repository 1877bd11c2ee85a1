"""Catalogue of faults: description, settings, and place of the implementation.

A fault joins the command line, the configuration files and the stress test by one entry in `FAULTS`. Nothing here
imports a numerical library, so that help is shown at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from glucoloop.plausible import GLUCOSE_BOUND, RATE_STEP
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


@dataclass(frozen=True)
class FaultEntry:
    """A fault of the catalogue."""

    name: str
    part: Literal["sensor", "pump"]
    summary: str
    make: str
    """Name of the function in `faulty`."""
    settings: tuple[Setting, ...] = ()
    timed: bool = True
    """Whether the fault comes and goes; otherwise it is always present."""

    @property
    def comes_and_goes(self) -> bool:
        """Whether there are times without the fault."""
        return self.name != "resolution"

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
        return FAULTS[self.name]


_NOTICED: Final = Setting("noticed", bool, "Whether the pump reports the fault: true or false.", Default(False))

FAULTS: Final[dict[str, FaultEntry]] = {
    entry.name: entry
    for entry in (
        FaultEntry("missing", "sensor", "readings do not arrive", "missing"),
        FaultEntry(
            "late",
            "sensor",
            "readings arrive late and do not say so",
            "late",
            (Setting("delay_min", float, "Delay of the readings, rounded up to samples.", Default(15.0)),),
        ),
        FaultEntry(
            "repeated",
            "sensor",
            "each reading is given several times",
            "repeated",
            (Setting("times", int, "Number of times that each reading is given.", Default(3)),),
        ),
        FaultEntry(
            "out-of-order",
            "sensor",
            "a random one of the latest readings is given",
            "out_of_order",
            (Setting("among", int, "Number of latest readings among which one is drawn.", Default(4)),),
        ),
        FaultEntry(
            "spikes",
            "sensor",
            "readings are off by a fixed amount",
            "spikes",
            (Setting("size_mg_dl", float, "Error of the readings, of either sign.", Default(60.0)),),
        ),
        FaultEntry("stuck", "sensor", "the reading at the start of the fault is repeated", "stuck"),
        FaultEntry(
            "drift",
            "sensor",
            "readings have an error that grows with time",
            "drift",
            (Setting("mg_dl_h", float, "Growth of the error in an hour, of either sign.", Default(5.0)),),
        ),
        FaultEntry(
            "calibration",
            "sensor",
            "readings are wrong by a gain and an offset",
            "calibration",
            (
                Setting("gain", float, "Factor from the correct reading to the given one.", Default(1.15)),
                Setting("offset_mg_dl", float, "Offset that is added after the gain.", Default(0.0)),
            ),
        ),
        FaultEntry(
            "compression",
            "sensor",
            "readings fall because someone lies on the sensor",
            "compression",
            (
                Setting("depth", float, "Part of the reading that is finally lost.", Default(0.3)),
                Setting("tau_min", float, "Time constant of fall and recovery.", Default(10.0)),
            ),
        ),
        FaultEntry(
            "saturation",
            "sensor",
            "readings are limited to a range",
            "saturation",
            (
                Setting("low_mg_dl", float, "Lower end of the range.", Default(40.0), quantity=GLUCOSE_BOUND),
                Setting("high_mg_dl", float, "Upper end of the range.", Default(400.0), quantity=GLUCOSE_BOUND),
            ),
        ),
        FaultEntry(
            "nonsense",
            "sensor",
            "a fixed number is given as a valid reading: nan, inf, 0, 2000",
            "nonsense",
            (Setting("value", float, "Number that is given.", Default(0.0)),),
        ),
        FaultEntry(
            "occlusion",
            "pump",
            "less insulin passes the line than the pump drives",
            "occlusion",
            (Setting("open_fraction", float, "Part of the insulin that is delivered.", Default(0.0)), _NOTICED),
        ),
        FaultEntry(
            "missed-pulses",
            "pump",
            "single doses at random are not delivered",
            "missed_pulses",
            (Setting("share", float, "Share of the doses that are missed.", Default(0.2)), _NOTICED),
            timed=False,
        ),
        FaultEntry("battery", "pump", "the pump is off, reports nothing, and starts again from rest", "battery"),
        FaultEntry(
            "resolution",
            "pump",
            "only whole steps are delivered, from a least dose on; the remainder is delivered later",
            "resolution",
            (
                Setting("step_mU_min", float, "Step of the rate.", Default(0.5), quantity=RATE_STEP),
                Setting("least_mU_min", float, "Least rate that is delivered.", Default(0.0)),
            ),
            timed=False,
        ),
    )
}


def fault(name: str, given: Mapping[str, object] | None = None) -> Fault:
    """A fault by name.

    Raises
    ------
    ValueError
        For an unknown fault or setting, a value of the wrong type, or times that exclude one another.
    """
    if name not in FAULTS:
        raise ValueError(f"unknown fault {name!r}; {known_names(name, FAULTS)}")
    entry, given = FAULTS[name], given or {}
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
