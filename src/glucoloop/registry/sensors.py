"""Catalogue of sensors: description, settings, and place of the function that makes each.

A sensor joins every command by one entry in `SENSORS`, or by the entry point of another package in the group
``glucoloop.sensors``. Its text is its name and its settings: ``white-noise, variance=1.45``. Nothing here imports a
numerical library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final

from glucoloop.plausible import NOISE_BOUND, NOISE_VARIANCE
from glucoloop.registry.entries import PartEntry, parsed, part_text
from glucoloop.registry.plugins import Catalogue
from glucoloop.registry.settings import About, Value, settings_record

LONGEST_DEAD_TIME_SAMPLES: Final = 288  # a day of 5-min samples


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


SENSORS: Final = Catalogue(
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
            name="dead-time",
            summary="readings that are given some samples later",
            make="glucoloop.sensors:dead_time",
            record=DeadTimeSettings,
        ),
    ),
)
USUAL_SENSOR: Final = "ideal"
sensor_entry: Final = SENSORS.find
"""Function that returns a sensor by name: of this package, of another one, or ``module:attribute``."""


@dataclass(frozen=True)
class SensorChoice:
    """A sensor with all its settings."""

    name: str
    settings: Mapping[str, Value]

    @property
    def text(self) -> str:
        """Text from which the same sensor is read."""
        return part_text(self.name, self.settings)

    def made(self, **known: Any) -> Any:
        """The sensor; see `PartEntry.made`."""
        return sensor_entry(self.name).made(self.settings, **known)


def chosen_sensor(name: str, given: Mapping[str, object]) -> SensorChoice:
    """A sensor by name, with the given settings and defaults for the others.

    Raises
    ------
    ValueError
        For an unknown sensor or setting, or a value of the wrong type or out of its bounds.
    """
    return SensorChoice(name, sensor_entry(name).complete(given))


def parse_sensor(text: str) -> SensorChoice:
    """Read a sensor from its text.

    Raises
    ------
    ValueError
        For a text that is not a sensor, an unknown one, or settings that it does not have.
    """
    return chosen_sensor(*parsed(text, "sensor", "white-noise, variance=1.45"))
