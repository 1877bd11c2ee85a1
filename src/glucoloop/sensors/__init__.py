"""Glucose sensors, each one class; all but the innermost wrap another one, their ``inner``.

A sensor joins every command by one class, entered in `SENSORS` or by the entry point of another package in the group
``glucoloop.sensors``.
"""

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.sensors import cgm
from glucoloop.sensors.delay import DeadTime, Lag, dead_time
from glucoloop.sensors.erring import Erring, erring
from glucoloop.sensors.noise import CorrelatedNoise, WhiteNoise, white_noise
from glucoloop.sensors.protocol import IdealSensor, Reading, Sensor, SensorAround, SensorComponent, whole_samples

SENSORS: Final = Catalogue(
    SensorComponent,
    (
        IdealSensor,
        WhiteNoise,
        CorrelatedNoise,
        Lag,
        DeadTime,
        cgm.Breton2008,
        cgm.Facchinetti2014,
        cgm.DexcomG5,
        cgm.DexcomG6,
        cgm.Vettoretti2019,
        cgm.Display,
    ),
    example="white-noise, variance=1.45",
)

__all__ = [
    "SENSORS",
    "CorrelatedNoise",
    "DeadTime",
    "Erring",
    "IdealSensor",
    "Lag",
    "Reading",
    "Sensor",
    "SensorAround",
    "SensorComponent",
    "WhiteNoise",
    "cgm",
    "dead_time",
    "erring",
    "white_noise",
    "whole_samples",
]
