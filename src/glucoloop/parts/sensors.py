"""Sensors: name and settings of each, and the place of the function that makes it.

A sensor joins every command by one class, entered in `SENSORS` or by the entry point of another package in the group
``glucoloop.sensors``.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final

from glucoloop.parts.catalogue import Catalogue
from glucoloop.parts.part import MadePart
from glucoloop.parts.setting import About
from glucoloop.plausible import DEAD_TIME, LAG, NOISE_BOUND, NOISE_VARIANCE
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY

LONGEST_LAG_MIN: Final = 120.0


class SensorPart(MadePart):
    """Declaration of a sensor.

    Its function is also given, if it has parameters of these names, ``inner`` (the sensor inside, at first one without
    error), ``site`` (the site that was asked for, or None) and ``sample_time_min``.
    """

    kind: ClassVar = "sensor"


class IdealSettings(SensorPart, name="ideal"):
    """Readings without error or delay; the innermost of a chain, which says where glucose is read."""

    make: ClassVar = "glucoloop.sensors:IdealSensor"
    site: Annotated[
        str | None,
        About(
            "Site: arterial or interstitial, or plasma or interstitial, depending on the patient; by default that at "
            "which glucose is controlled."
        ),
    ] = None


class WhiteNoiseSettings(SensorPart, name="white-noise"):
    """Bounded white noise on each reading."""

    make: ClassVar = "glucoloop.sensors:white_noise"
    variance: Annotated[
        float, About("Variance of the noise of each reading.", at_least=0.0, at_most=10_000.0, quantity=NOISE_VARIANCE)
    ] = 1.45
    bound_mg_dl: Annotated[
        float, About("Largest deviation of a reading.", above=0.0, at_most=1000.0, quantity=NOISE_BOUND)
    ] = 5.0


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
    lag_min: Annotated[
        float, About("Time constant of the lag behind glucose.", above=0.0, at_most=LONGEST_LAG_MIN, quantity=LAG)
    ] = 10.0


class DeadTimeSettings(SensorPart, name="dead-time"):
    """Readings that are given some time later."""

    make: ClassVar = "glucoloop.sensors:dead_time"
    minutes: Annotated[
        float,
        About(
            "Time after which a reading is given; a whole number of samples.",
            at_least=0.0,
            at_most=MIN_PER_DAY,
            unit="min",
            quantity=DEAD_TIME,
        ),
    ] = 5.0

    def samples(self, sample_time_min: float) -> int:
        """The time as a number of samples; Refusal unless it is a whole number of them."""
        return whole_samples(self.minutes, sample_time_min, "a dead time")

    def made(self, **known: Any) -> Any:
        """The sensor; one without delay where the time is 0."""
        samples = self.samples(known["sample_time_min"])
        return self.made_of({"samples": samples}, known) if samples else known["inner"]


SENSORS: Final = Catalogue(
    SensorPart,
    (IdealSettings, WhiteNoiseSettings, CorrelatedNoiseSettings, LagSettings, DeadTimeSettings),
    example="white-noise, variance=1.45",
)


def whole_samples(minutes: float, sample_time_min: float, what: str) -> int:
    """Minutes as a number of samples; Refusal unless it is a whole one. `what` names the quantity in messages."""
    samples = round(minutes / sample_time_min)
    if abs(samples * sample_time_min - minutes) > 1e-9 * max(minutes, sample_time_min):
        below = int(minutes / sample_time_min) * sample_time_min
        raise Refusal(
            f"{what} of {minutes:g} min is not a whole number of {sample_time_min:g}-min samples; "
            f"give {below:g} or {below + sample_time_min:g} min"
        )
    return samples
