"""Catalogue of faults: description, settings, and place of the implementation.

A fault joins the command line, the configuration files, the stress test and the random faults of ``glucoloop verify``
by one entry in `FAULTS`; one of another package, by an entry point in the group ``glucoloop.faults``, joins all but the
last. Nothing here imports a numerical library, so that help is shown at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Literal

from glucoloop.refusal import Refusal
from glucoloop.registry import fault_settings as declared
from glucoloop.registry.entries import PartEntry
from glucoloop.registry.fault_settings import FaultKey, FaultTimes
from glucoloop.registry.plugins import Catalogue
from glucoloop.registry.settings import Setting, Value, known_names, settings_of

START: Final = "start_min"
LATEST: Final = "latest_min"
DURATION: Final = "duration_min"
PER_DAY: Final = "per_day"
KEY: Final = "key"

TIMING: Final = settings_of(FaultTimes)
"""Settings of the times of a fault, which have no value unless one is given."""
(OWN_KEY,) = settings_of(FaultKey)

Draw = Callable[[Callable[..., Any]], dict[str, Any]]
"""Function that returns values ``(people,)`` by setting. It is given ``even(low, high, index=0)``, which draws
evenly distributed numbers; a setting that needs a second number gives it another index."""
Shared = Callable[[Callable[[str, int, int], int]], dict[str, Any]]
"""Function that returns values by setting. It is given a function ``whole(name, least, most)``, which draws a whole
number."""


@dataclass(frozen=True, kw_only=True)
class FaultEntry(PartEntry):
    """A fault of the catalogue.

    Its function is also given, if it has parameters of these names, ``inner``, ``episodes``, ``sample_time_min``,
    ``limits`` and ``key``. It returns a record whose field ``inner`` is the sensor or pump inside.
    """

    kind: ClassVar = "fault"

    part: Literal["sensor", "pump"]
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


FAULTS: Final = Catalogue(
    "fault",
    FaultEntry,
    (
        FaultEntry(
            name="missing",
            part="sensor",
            summary="readings do not arrive",
            make=f"{_SENSORS}:missing",
        ),
        FaultEntry(
            name="late",
            part="sensor",
            summary="readings arrive late and do not say so",
            make=f"{_SENSORS}:late_by",
            record=declared.LateSettings,
            shared=lambda whole: {"delay_min": 5.0 * whole("delay", 1, 12)},
        ),
        FaultEntry(
            name="repeated",
            part="sensor",
            summary="each reading is given several times",
            make=f"{_SENSORS}:repeated",
            record=declared.RepeatedSettings,
            draw=lambda even: {"times": even(2.0, 13.0) // 1.0},
        ),
        FaultEntry(
            name="out-of-order",
            part="sensor",
            summary="a random one of the latest readings is given",
            make=f"{_SENSORS}:out_of_order",
            record=declared.OutOfOrderSettings,
            shared=lambda whole: {"among": whole("among", 2, 8)},
        ),
        FaultEntry(
            name="spikes",
            part="sensor",
            summary="readings are off by a fixed amount",
            make=f"{_SENSORS}:spikes",
            record=declared.SpikesSettings,
            draw=lambda even: {"size_mg_dl": even(-1000.0, 1000.0)},
        ),
        FaultEntry(
            name="stuck",
            part="sensor",
            summary="the reading at the start of the fault is repeated",
            make=f"{_SENSORS}:stuck",
        ),
        FaultEntry(
            name="drift",
            part="sensor",
            summary="readings have an error that grows with time",
            make=f"{_SENSORS}:drift",
            record=declared.DriftSettings,
            draw=lambda even: {"mg_dl_h": even(-1.0, 1.0) * 10.0 ** even(0.0, 3.0, 1)},
        ),
        FaultEntry(
            name="calibration",
            part="sensor",
            summary="readings are wrong by a gain and an offset",
            make=f"{_SENSORS}:calibration",
            record=declared.CalibrationSettings,
            draw=lambda even: {"gain": 10.0 ** even(-1.0, 1.0), "offset_mg_dl": even(-200.0, 200.0, 1)},
        ),
        FaultEntry(
            name="compression",
            part="sensor",
            summary="readings fall because someone lies on the sensor",
            make=f"{_SENSORS}:compression",
            record=declared.CompressionSettings,
            draw=lambda even: {"depth": even(0.05, 1.0), "tau_min": even(1.0, 60.0, 1)},
        ),
        FaultEntry(
            name="saturation",
            part="sensor",
            summary="readings are limited to a range",
            make=f"{_SENSORS}:saturation",
            record=declared.SaturationSettings,
            draw=_range,
        ),
        FaultEntry(
            name="nonsense",
            part="sensor",
            summary="a fixed number is given as a valid reading: nan, inf, 0, 2000",
            make=f"{_SENSORS}:nonsense",
            record=declared.NonsenseSettings,
            draw=lambda even: {"value": [_NONSENSE[int(place)] for place in even(0.0, float(len(_NONSENSE)))]},
        ),
        # Pumps' faults from the inside out, as they are drawn: what is around a pump without power does not restart.
        FaultEntry(
            name="resolution",
            part="pump",
            summary="only whole steps are delivered, from a least dose on; the remainder is delivered later",
            make="glucoloop.pumps:with_resolution",
            record=declared.ResolutionSettings,
            timed=False,
            comes_and_goes=False,
            draw=_steps,
            idle={"step_mU_min": _NO_STEP, "least_mU_min": 0.0},
        ),
        FaultEntry(
            name="battery",
            part="pump",
            summary="the pump is off, reports nothing, and starts again from rest",
            make=f"{_PUMPS}:battery_gap",
        ),
        FaultEntry(
            name="missed-pulses",
            part="pump",
            summary="single doses at random are not delivered",
            make=f"{_PUMPS}:missed_pulses",
            record=declared.MissedPulsesSettings,
            timed=False,
            each_sample="share",
        ),
        FaultEntry(
            name="occlusion",
            part="pump",
            summary="less insulin passes the line than the pump drives",
            make=f"{_PUMPS}:occlusion",
            record=declared.OcclusionSettings,
            draw=lambda even: {"open_fraction": (even(0.0, 1.0) >= 0.5) * even(0.0, 0.95, 1)},
            both="noticed",
        ),
        FaultEntry(
            name="unheard",
            part="pump",
            summary="commands do not reach the pump, which goes to its least rate",
            make=f"{_PUMPS}:unheard",
        ),
    ),
)


fault_entry: Final = FAULTS.find
"""Function that returns a fault by name: of this package, of another one, or ``module:attribute``."""
fault_names: Final = FAULTS.names
"""Function that returns the names of all faults, those of other packages included."""


def fault(name: str, given: Mapping[str, object] | None = None) -> Fault:
    """A fault by name.

    Raises
    ------
    ValueError
        For an unknown fault or setting, a value of the wrong type or out of its bounds, or times that exclude one
        another.
    """
    entry, given = fault_entry(name), given or {}
    settings = entry.all_settings
    for key in given:
        if key not in settings:
            raise Refusal(f"the fault {name} has no setting {key!r}; {known_names(key, settings)}")
    checked = {key: settings[key].check(value) for key, value in given.items()}
    _check_times(name, checked)
    own = {setting.name: checked.get(setting.name, setting.default.noise_free) for setting in entry.settings}
    entry.values(own)
    when = {setting.name: checked[setting.name] for setting in (*TIMING, OWN_KEY) if setting.name in checked}
    return Fault(name=name, settings={**when, **own})


def _check_times(name: str, given: Mapping[str, Value]) -> None:
    for key in (START, LATEST, DURATION, PER_DAY):
        value = float(given.get(key, 0.0))
        least = "above 0" if key in (DURATION, PER_DAY) and key in given else "of 0 or more"
        if not (0.0 <= value < float("inf")) or (least == "above 0" and value == 0.0):
            raise Refusal(f"{key} of the fault {name} is {value:g}; give a finite value {least}")
    if PER_DAY in given and (START in given or LATEST in given):
        other = START if START in given else LATEST
        raise Refusal(f"the fault {name} has both {PER_DAY} and {other}; it is either random or planned, leave one out")
    if float(given.get(LATEST, float("inf"))) < float(given.get(START, 0.0)):
        raise Refusal(
            f"the fault {name} is to begin from {given[START]:g} to {given[LATEST]:g} min; "
            f"give a {LATEST} of {given[START]:g} or more"
        )
