"""Faults of a sensor: small objects that wrap any `inner` sensor, an ideal one by default, and one another."""

from glucoloop.sensors.faults.altered import (
    Calibration,
    Drift,
    Missing,
    Nonsense,
    Saturation,
    Spikes,
    calibration,
    drift,
    missing,
    nonsense,
    saturation,
    spikes,
)
from glucoloop.sensors.faults.compression import Compression, compression
from glucoloop.sensors.faults.earlier import (
    Late,
    OutOfOrder,
    Repeated,
    Stuck,
    late,
    late_by,
    out_of_order,
    repeated,
    stuck,
)

__all__ = [
    "Calibration",
    "Compression",
    "Drift",
    "Late",
    "Missing",
    "Nonsense",
    "OutOfOrder",
    "Repeated",
    "Saturation",
    "Spikes",
    "Stuck",
    "calibration",
    "compression",
    "drift",
    "late",
    "late_by",
    "missing",
    "nonsense",
    "out_of_order",
    "repeated",
    "saturation",
    "spikes",
    "stuck",
]
