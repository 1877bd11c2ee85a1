"""Faults of a sensor: small objects that wrap any sensor, and one another."""

from glucoloop.sensors.faults.calibration import Calibration, calibration
from glucoloop.sensors.faults.compression import Compression, compression
from glucoloop.sensors.faults.drift import Drift, drift
from glucoloop.sensors.faults.late import Late, late, late_by
from glucoloop.sensors.faults.missing import Missing, missing
from glucoloop.sensors.faults.nonsense import Nonsense, nonsense
from glucoloop.sensors.faults.out_of_order import OutOfOrder, out_of_order
from glucoloop.sensors.faults.repeated import Repeated, repeated
from glucoloop.sensors.faults.saturation import Saturation, saturation
from glucoloop.sensors.faults.spikes import Spikes, spikes
from glucoloop.sensors.faults.stuck import Stuck, stuck

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
