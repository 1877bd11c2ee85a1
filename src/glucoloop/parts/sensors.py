"""Sensors: name and settings of each, and the place of the function that makes it.

A sensor joins every command by one class, entered in `SENSORS` or by the entry point of another package in the group
``glucoloop.sensors``.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop.parts.catalogue import Catalogue
from glucoloop.parts.part import MadePart
from glucoloop.parts.setting import About
from glucoloop.plausible import NOISE_BOUND, NOISE_VARIANCE

LONGEST_DEAD_TIME_SAMPLES: Final = 288  # a day of 5-min samples
LONGEST_LAG_MIN: Final = 120.0


class SensorPart(MadePart):
    """Declaration of a sensor.

    Its function is also given, if it has parameters of these names, ``site`` (the site that was asked for, or None),
    ``inner`` (a sensor at that site without error) and ``sample_time_min``.
    """

    kind: ClassVar = "sensor"


class IdealSettings(SensorPart, name="ideal"):
    """Readings without error or delay."""

    make: ClassVar = "glucoloop.sensors:IdealSensor"


class WhiteNoiseSettings(SensorPart, name="white-noise"):
    """Bounded white noise on each reading."""

    make: ClassVar = "glucoloop.sensors:white_noise"
    variance: Annotated[
        float, About("Variance of the noise of each reading.", at_least=0.0, quantity=NOISE_VARIANCE)
    ] = 1.45
    bound_mg_dl: Annotated[float, About("Largest deviation of a reading.", above=0.0, quantity=NOISE_BOUND)] = 5.0


class CorrelatedNoiseSettings(SensorPart, name="correlated-noise"):
    """Noise that is correlated from sample to sample, a first-order process."""

    make: ClassVar = "glucoloop.sensors:correlated_noise"
    variance: Annotated[
        float, About("Variance of the error of each reading.", at_least=0.0, quantity=NOISE_VARIANCE)
    ] = 9.0
    correlation: Annotated[
        float, About("Correlation of the errors of two consecutive readings.", at_least=0.0, below=1.0)
    ] = 0.7


class LagSettings(SensorPart, name="lag"):
    """Glucose behind a first-order lag, as under the skin."""

    make: ClassVar = "glucoloop.sensors:lag"
    lag_min: Annotated[float, About("Time constant of the lag behind glucose.", above=0.0, at_most=LONGEST_LAG_MIN)] = (
        10.0
    )


class DeadTimeSettings(SensorPart, name="dead-time"):
    """Readings that are given some samples later."""

    make: ClassVar = "glucoloop.sensors:dead_time"
    samples: Annotated[
        int, About("Samples after which a reading is given.", at_least=0, at_most=LONGEST_DEAD_TIME_SAMPLES)
    ] = 1


SENSORS: Final = Catalogue(
    SensorPart,
    (IdealSettings, WhiteNoiseSettings, CorrelatedNoiseSettings, LagSettings, DeadTimeSettings),
    example="white-noise, variance=1.45",
)
USUAL_SENSOR: Final = SENSORS.usual
