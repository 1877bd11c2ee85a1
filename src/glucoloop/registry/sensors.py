"""Catalogue of sensors: description, settings, and place of the function that makes each.

A sensor joins every command by one entry in `SENSORS`, or by the entry point of another package in the group
``glucoloop.sensors``. Its text is its name and its settings: ``white-noise, variance=1.45``. Nothing here imports a
numerical library.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

from glucoloop.plausible import NOISE_BOUND, NOISE_VARIANCE
from glucoloop.registry.entries import PartCatalogue, PartEntry
from glucoloop.registry.settings import About, settings_record

LONGEST_DEAD_TIME_SAMPLES: Final = 288  # a day of 5-min samples
LONGEST_LAG_MIN: Final = 120.0


@dataclass(frozen=True, kw_only=True)
class SensorEntry(PartEntry):
    """A sensor of the catalogue.

    Its function is also given, if it has parameters of these names, ``site`` (the site that was asked for, or None),
    ``inner`` (a sensor at that site without error) and ``sample_time_min``.
    """

    kind: ClassVar = "sensor"


@settings_record
class WhiteNoiseSettings:
    """Settings of the sensor `white-noise`."""

    variance: Annotated[
        float,
        About(
            "Variance of the noise of each reading, (mg/dl)².",
            at_least=0.0,
            quantity=NOISE_VARIANCE,
            called="noise variance",
        ),
    ] = 1.45
    bound_mg_dl: Annotated[
        float, About("Largest deviation of a reading.", above=0.0, quantity=NOISE_BOUND, called="noise bound")
    ] = 5.0


@settings_record
class CorrelatedNoiseSettings:
    """Settings of the sensor `correlated-noise`."""

    variance: Annotated[
        float,
        About(
            "Variance of the error of each reading, (mg/dl)².",
            at_least=0.0,
            quantity=NOISE_VARIANCE,
            called="noise variance",
        ),
    ] = 9.0
    correlation: Annotated[
        float, About("Correlation of the errors of two consecutive readings.", at_least=0.0, below=1.0)
    ] = 0.7


@settings_record
class LagSettings:
    """Settings of the sensor `lag`."""

    lag_min: Annotated[
        float,
        About(
            "Time constant of the lag behind glucose, in minutes.",
            above=0.0,
            at_most=LONGEST_LAG_MIN,
            called="lag of the sensor",
        ),
    ] = 10.0


@settings_record
class DeadTimeSettings:
    """Settings of the sensor `dead-time`."""

    samples: Annotated[
        int,
        About(
            "Samples after which a reading is given.",
            at_least=0,
            at_most=LONGEST_DEAD_TIME_SAMPLES,
            called="dead time in samples",
        ),
    ] = 1


SENSORS: Final = PartCatalogue(
    "sensor",
    SensorEntry,
    (
        SensorEntry(name="ideal", summary="neither error nor delay", make="glucoloop.sensors:IdealSensor"),
        SensorEntry(
            name="white-noise",
            summary="bounded white noise on each reading",
            make="glucoloop.sensors:white_noise",
            record=WhiteNoiseSettings,
        ),
        SensorEntry(
            name="correlated-noise",
            summary="noise that is correlated from sample to sample, a first-order process",
            make="glucoloop.sensors:correlated_noise",
            record=CorrelatedNoiseSettings,
        ),
        SensorEntry(
            name="lag",
            summary="glucose behind a first-order lag, as under the skin",
            make="glucoloop.sensors:lag",
            record=LagSettings,
        ),
        SensorEntry(
            name="dead-time",
            summary="readings that are given some samples later",
            make="glucoloop.sensors:dead_time",
            record=DeadTimeSettings,
        ),
    ),
    example="white-noise, variance=1.45",
)
USUAL_SENSOR: Final = "ideal"
