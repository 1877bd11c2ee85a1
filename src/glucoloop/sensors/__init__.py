"""Glucose sensors and their faults: small objects that wrap an `inner` sensor, an ideal one by default."""

from glucoloop.sensors import cgm
from glucoloop.sensors.delay import DeadTime, Lag, dead_time, lag
from glucoloop.sensors.erring import Erring, erring
from glucoloop.sensors.faults import (
    calibration,
    compression,
    drift,
    late,
    missing,
    nonsense,
    out_of_order,
    repeated,
    saturation,
    spikes,
    stuck,
)
from glucoloop.sensors.noise import CorrelatedNoise, WhiteNoise, correlated_noise, white_noise
from glucoloop.sensors.protocol import IdealSensor, Reading, Sensor

__all__ = [
    "CorrelatedNoise",
    "DeadTime",
    "Erring",
    "IdealSensor",
    "Lag",
    "Reading",
    "Sensor",
    "WhiteNoise",
    "calibration",
    "cgm",
    "compression",
    "correlated_noise",
    "dead_time",
    "drift",
    "erring",
    "lag",
    "late",
    "missing",
    "nonsense",
    "out_of_order",
    "repeated",
    "saturation",
    "spikes",
    "stuck",
    "white_noise",
]
