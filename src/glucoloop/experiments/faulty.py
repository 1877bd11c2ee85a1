"""Sensors and pumps with the requested faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, Final

from glucoloop.episodes import Episodes, always, once, recurring
from glucoloop.pumps import DoseLimits, Pump, with_resolution
from glucoloop.pumps import faults as of_pump
from glucoloop.registry.faults import DURATION, KEY, LATEST, PER_DAY, START, Fault
from glucoloop.sensors import Sensor
from glucoloop.sensors import faults as of_sensor
from glucoloop.units import MIN_PER_DAY

_HAIR: Final = 1e-9


def faulty_sensor(sensor: Sensor, faults: Iterable[Fault], sample_time_min: float) -> Sensor:
    """A sensor wrapped in faults, the first one innermost; faults of a pump are skipped.

    Raises
    ------
    ValueError
        If a fault is not possible.
    """
    for fault in faults:
        if fault.entry.part == "sensor":
            sensor = _SENSOR[fault.entry.make](sensor, fault, sample_time_min)
    return sensor


def faulty_pump(pump: Pump, faults: Iterable[Fault], sample_time_min: float, limits: DoseLimits) -> Pump:
    """A pump wrapped in faults, the first one innermost; faults of a sensor are skipped."""
    for fault in faults:
        if fault.entry.part == "pump":
            pump = _PUMP[fault.entry.make](pump, fault, sample_time_min, limits)
    return pump


def episodes_of(fault: Fault, sample_time_min: float) -> Episodes:
    """Episodes in which a fault is present."""
    when, key = fault.settings, int(fault.settings.get(KEY, 0))

    def samples(name: str) -> int:
        return math.ceil(float(when[name]) / sample_time_min - _HAIR)

    lasting = max(1, samples(DURATION)) if DURATION in when else math.inf
    if PER_DAY in when:
        probability = float(when[PER_DAY]) * sample_time_min / MIN_PER_DAY
        if probability > 1.0:
            raise ValueError(
                f"{PER_DAY} of the fault {fault.name} is {when[PER_DAY]:g}; "
                f"give at most one a sample, {MIN_PER_DAY / sample_time_min:g}"
            )
        return recurring(probability, lasting if DURATION in when else 1, key=key)
    if not {START, LATEST, DURATION} & when.keys():
        return always(key=key)
    start = samples(START) if START in when else 0
    return once(start, lasting, latest_sample=samples(LATEST) if LATEST in when else None, key=key)


def _whole(fault: Fault, name: str) -> int:
    return int(fault.settings[name])


def _number(fault: Fault, name: str) -> float:
    return float(fault.settings[name])


MakeSensor = Callable[[Sensor, Fault, float], Any]
MakePump = Callable[[Pump, Fault, float, DoseLimits], Any]


def _missing(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    return of_sensor.missing(episodes_of(fault, sample_time_min), inner)


def _late(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    delay = _number(fault, "delay_min") / sample_time_min
    samples = math.ceil(delay - _HAIR) if math.isfinite(delay) else 0
    return of_sensor.late(samples, episodes_of(fault, sample_time_min), inner)


def _repeated(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    return of_sensor.repeated(_whole(fault, "times"), episodes_of(fault, sample_time_min), inner)


def _out_of_order(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    return of_sensor.out_of_order(_whole(fault, "among"), episodes_of(fault, sample_time_min), inner)


def _spikes(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    return of_sensor.spikes(_number(fault, "size_mg_dl"), episodes_of(fault, sample_time_min), inner)


def _stuck(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    return of_sensor.stuck(episodes_of(fault, sample_time_min), inner)


def _drift(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    when = episodes_of(fault, sample_time_min)
    return of_sensor.drift(_number(fault, "mg_dl_h"), when, inner, sample_time_min=sample_time_min)


def _calibration(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    gain, offset = _number(fault, "gain"), _number(fault, "offset_mg_dl")
    return of_sensor.calibration(gain, offset, episodes_of(fault, sample_time_min), inner)


def _compression(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    return of_sensor.compression(
        _number(fault, "depth"),
        episodes_of(fault, sample_time_min),
        inner,
        tau_min=_number(fault, "tau_min"),
        sample_time_min=sample_time_min,
    )


def _saturation(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    low, high = _number(fault, "low_mg_dl"), _number(fault, "high_mg_dl")
    return of_sensor.saturation(low, high, episodes_of(fault, sample_time_min), inner)


def _nonsense(inner: Sensor, fault: Fault, sample_time_min: float) -> Sensor:
    return of_sensor.nonsense(_number(fault, "value"), episodes_of(fault, sample_time_min), inner)


def _occlusion(inner: Pump, fault: Fault, sample_time_min: float, limits: DoseLimits) -> Pump:
    del limits
    return of_pump.occlusion(
        episodes_of(fault, sample_time_min),
        inner,
        open_fraction=_number(fault, "open_fraction"),
        noticed=bool(fault.settings["noticed"]),
    )


def _missed_pulses(inner: Pump, fault: Fault, sample_time_min: float, limits: DoseLimits) -> Pump:
    del sample_time_min, limits
    key, noticed = int(fault.settings.get(KEY, 0)), bool(fault.settings["noticed"])
    return of_pump.missed_pulses(_number(fault, "share"), inner, noticed=noticed, key=key)


def _battery(inner: Pump, fault: Fault, sample_time_min: float, limits: DoseLimits) -> Pump:
    del limits
    return of_pump.battery_gap(episodes_of(fault, sample_time_min), inner)


def _resolution(inner: Pump, fault: Fault, sample_time_min: float, limits: DoseLimits) -> Pump:
    del sample_time_min
    step, least = _number(fault, "step_mU_min"), _number(fault, "least_mU_min")
    return with_resolution(step, inner, least_mU_min=least, limits=limits)


_SENSOR: Final[dict[str, MakeSensor]] = {
    "missing": _missing,
    "late": _late,
    "repeated": _repeated,
    "out_of_order": _out_of_order,
    "spikes": _spikes,
    "stuck": _stuck,
    "drift": _drift,
    "calibration": _calibration,
    "compression": _compression,
    "saturation": _saturation,
    "nonsense": _nonsense,
}
_PUMP: Final[dict[str, MakePump]] = {
    "occlusion": _occlusion,
    "missed_pulses": _missed_pulses,
    "battery": _battery,
    "resolution": _resolution,
}
