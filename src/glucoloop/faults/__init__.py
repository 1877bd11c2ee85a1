"""Faults of sensors and pumps, each one class around a sensor or a pump.

A fault joins every command, the stress test and the random faults of ``glucoloop verify`` by one class, entered in
`FAULTS`; one of another package, by an entry point in the group ``glucoloop.faults``, joins all but the last.
"""

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.faults.fault import DURATION, KEY, LATEST, PER_DAY, START, TIMING, FaultComponent, Timed, Untimed
from glucoloop.faults.pump import (
    PUMP_FAULTS,
    Battery,
    CoarseDelivery,
    Misreported,
    MissedPulses,
    Occlusion,
    PumpFault,
    Unheard,
)
from glucoloop.faults.schedule import Episode, Episodes, always, never, once, recurring
from glucoloop.faults.sensor import (
    SENSOR_FAULTS,
    Calibration,
    Compression,
    Drift,
    Late,
    Missing,
    Nonsense,
    OutOfOrder,
    Repeated,
    Saturation,
    SensorFault,
    Spikes,
    Stuck,
)

FAULTS: Final = Catalogue(
    FaultComponent, (*SENSOR_FAULTS, *PUMP_FAULTS), example="missing, start_min=120, duration_min=30"
)

__all__ = [
    "DURATION",
    "FAULTS",
    "KEY",
    "LATEST",
    "PER_DAY",
    "START",
    "TIMING",
    "Battery",
    "Calibration",
    "CoarseDelivery",
    "Compression",
    "Drift",
    "Episode",
    "Episodes",
    "FaultComponent",
    "Late",
    "Misreported",
    "MissedPulses",
    "Missing",
    "Nonsense",
    "Occlusion",
    "OutOfOrder",
    "PumpFault",
    "Repeated",
    "Saturation",
    "SensorFault",
    "Spikes",
    "Stuck",
    "Timed",
    "Unheard",
    "Untimed",
    "always",
    "never",
    "once",
    "recurring",
]  # fmt: skip
