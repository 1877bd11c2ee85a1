"""Sensors and pumps with the requested faults."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from glucoloop.faults import FaultPart
from glucoloop.pumps import DoseLimits, Pump
from glucoloop.sensors import Sensor


def faulty_sensor(
    sensor: Sensor, faults: Iterable[FaultPart], sample_time_min: float, warm_up_min: float = 0.0
) -> Sensor:
    """A sensor wrapped in faults, the first one innermost; faults of a pump are skipped."""
    for fault in faults:
        if fault.part == "sensor":
            sensor = put_around(sensor, fault, sample_time_min, warm_up_min=warm_up_min)
    return sensor


def faulty_pump(
    pump: Pump, faults: Iterable[FaultPart], sample_time_min: float, limits: DoseLimits, warm_up_min: float = 0.0
) -> Pump:
    """A pump wrapped in faults, the first one innermost; faults of a sensor are skipped."""
    for fault in faults:
        if fault.part == "pump":
            pump = put_around(pump, fault, sample_time_min, limits, warm_up_min=warm_up_min)
    return pump


def put_around(
    inner: Any,
    fault: FaultPart,
    sample_time_min: float,
    limits: DoseLimits | None = None,
    *,
    warm_up_min: float = 0.0,
) -> Any:
    """A sensor or pump wrapped in one fault, whose times count from the end of the warm-up."""
    return fault.made(inner=inner, sample_time_min=sample_time_min, limits=limits, warm_up_min=warm_up_min)
