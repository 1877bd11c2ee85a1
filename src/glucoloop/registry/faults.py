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
    Setting(START, float, "When it begins, rounded up to a sample.", Default(0.0)),
    Setting(LATEST, float, "With it the start is drawn between the two, for each person.", Default(0.0)),
    Setting(
        DURATION, float, "How long it lasts; by default to the end, or one sample if it comes by chance.", Default(0.0)
    ),
    Setting(PER_DAY, float, "How often it comes in a day by chance, in place of a start.", Default(0.0)),
)
"""Settings of the times of a fault, which have no value unless one is given."""
OWN_KEY: Final = Setting(KEY, int, "Sets its chance apart from that of a second fault of the same kind.", Default(0))


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


_NOTICED: Final = Setting("noticed", bool, "Whether the pump tells of it: true or false.", Default(False))

FAULTS: Final[dict[str, FaultEntry]] = {
    entry.name: entry
    for entry in (
        FaultEntry("missing", "sensor", "readings do not arrive", "missing"),
        FaultEntry(
            "late",
            "sensor",
            "readings arrive late and do not say so",
            "late",
            (Setting("delay_min", float, "By how much, rounded up to samples.", Default(15.0)),),
        ),
        FaultEntry(
            "repeated",
            "sensor",
            "each reading is told several times",
            "repeated",
            (Setting("times", int, "How often.", Default(3)),),
        ),
        FaultEntry(
            "out-of-order",
            "sensor",
            "any one of the latest readings is told",
            "out_of_order",
            (Setting("among", int, "Of how many.", Default(4)),),
        ),
        FaultEntry(
            "spikes",
            "sensor",
            "readings are off by a fixed amount",
            "spikes",
            (Setting("size_mg_dl", float, "Of either sign.", Default(60.0)),),
        ),
        FaultEntry("stuck", "sensor", "the reading at which it begins is told on and on", "stuck"),
        FaultEntry(
            "drift",
            "sensor",
            "readings go off more and more",
            "drift",
            (Setting("mg_dl_h", float, "By how much in an hour, of either sign.", Default(5.0)),),
        ),
        FaultEntry(
            "calibration",
            "sensor",
            "readings are wrong by a gain and an offset",
            "calibration",
            (
                Setting("gain", float, "Of what is told over what is read.", Default(1.15)),
                Setting("offset_mg_dl", float, "Added after that.", Default(0.0)),
            ),
        ),
        FaultEntry(
            "compression",
            "sensor",
            "readings fall because someone lies on the sensor",
            "compression",
            (
                Setting("depth", float, "Part of the reading that is lost in the end.", Default(0.3)),
                Setting("tau_min", float, "Time constant of fall and recovery.", Default(10.0)),
            ),
        ),
        FaultEntry(
            "saturation",
            "sensor",
            "readings end at the ends of a range",
            "saturation",
            (
                Setting("low_mg_dl", float, "Its lower end.", Default(40.0), quantity=GLUCOSE_BOUND),
                Setting("high_mg_dl", float, "Its upper end.", Default(400.0), quantity=GLUCOSE_BOUND),
            ),
        ),
        FaultEntry(
            "nonsense",
            "sensor",
            "a number that is no glucose is told as if it were: nan, inf, 0, 2000",
            "nonsense",
            (Setting("value", float, "The number.", Default(0.0)),),
        ),
        FaultEntry(
            "occlusion",
            "pump",
            "less is delivered than the pump drives",
            "occlusion",
            (Setting("open_fraction", float, "Part that is delivered.", Default(0.0)), _NOTICED),
        ),
        FaultEntry(
            "missed-pulses",
            "pump",
            "now and then a dose is not delivered",
            "missed_pulses",
            (Setting("share", float, "Of the doses.", Default(0.2)), _NOTICED),
            timed=False,
        ),
        FaultEntry("battery", "pump", "the pump is off, says nothing, and starts again from rest", "battery"),
        FaultEntry(
            "resolution",
            "pump",
            "only whole steps are delivered, and nothing below a least dose; what is left is owed",
            "resolution",
            (
                Setting("step_mU_min", float, "The step.", Default(0.5), quantity=RATE_STEP),
                Setting("least_mU_min", float, "The least dose.", Default(0.0)),
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
            f"the fault {name} has both {PER_DAY} and {other}; it comes by chance or is planned, leave one out"
        )
    if float(given.get(LATEST, float("inf"))) < float(given.get(START, 0.0)):
        raise ValueError(
            f"the fault {name} is to begin from {given[START]:g} to {given[LATEST]:g} min; "
            f"give a {LATEST} of {given[START]:g} or more"
        )
