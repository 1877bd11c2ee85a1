"""Sensors and pumps with the requested faults."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

from glucoloop.episodes import Episodes, always, once, recurring
from glucoloop.faults import DURATION, KEY, LATEST, PER_DAY, START, FaultPart
from glucoloop.pumps import DoseLimits, Pump
from glucoloop.refusal import Refusal
from glucoloop.sensors import Sensor
from glucoloop.units import MIN_PER_DAY

_HAIR: Final = 1e-9


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
    return fault.made(
        inner=inner,
        sample_time_min=sample_time_min,
        limits=limits,
        key=int(fault.values().get(KEY, 0)),
        **({"episodes": episodes_of(fault, sample_time_min, warm_up_min)} if fault.timed else {}),
    )


def episodes_of(fault: FaultPart, sample_time_min: float, warm_up_min: float = 0.0) -> Episodes:
    """Episodes in which a fault is present; planned ones count from the end of the warm-up."""
    when = fault.values()
    key = int(when.get(KEY, 0))

    def samples(name: str) -> int:
        return math.ceil(float(when[name]) / sample_time_min - _HAIR)

    lasting = max(1, samples(DURATION)) if DURATION in when else math.inf
    if PER_DAY in when:
        probability = float(when[PER_DAY]) * sample_time_min / MIN_PER_DAY
        if probability > 1.0:
            raise Refusal(
                f"{PER_DAY} of the fault {fault.name} is {when[PER_DAY]:g}; "
                f"give at most one a sample, {MIN_PER_DAY / sample_time_min:g}"
            )
        return recurring(probability, lasting if DURATION in when else 1, key=key)
    if not {START, LATEST, DURATION} & when.keys():
        return always(key=key)
    before = round(warm_up_min / sample_time_min)
    start = before + (samples(START) if START in when else 0)
    return once(start, lasting, latest_sample=before + samples(LATEST) if LATEST in when else None, key=key)
