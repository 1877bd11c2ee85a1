"""Sensors: name and settings of each, and the place of the function that makes it.

A sensor joins every command by one class, entered in `SENSORS` or by the entry point of another package in the group
``glucoloop.sensors``.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.component.code import loaded
from glucoloop.component.effects import READINGS, Need
from glucoloop.component.part import MadePart
from glucoloop.component.setting import About
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import DEAD_TIME, GLUCOSE_BOUND, LAG, NOISE_BOUND, NOISE_VARIANCE
from glucoloop.units import MIN_PER_DAY

_NOISE: Final = Need("the variance of the noise is 0")
LONGEST_LAG_MIN: Final = 120.0
_LONGEST_WEAR_MIN: Final = 30.0 * MIN_PER_DAY


class SensorPart(MadePart):
    """Declaration of a sensor.

    Its function is also given, if it has parameters of these names, ``inner`` (the sensor inside, at first one without
    error), ``site`` (the site that was asked for, or None) and ``sample_time_min``.
    """

    kind: ClassVar = "sensor"

    def needs(self) -> tuple[Need, ...]:
        """A sensor has an effect where something uses its readings."""
        return (READINGS,)

    def recorded(self) -> SensorPart | None:
        """Sensor of a record from which a model is identified, by default this one; None where it is left out.

        Such a record has its own white noise, and no delay of the kind that a controller is told of.
        """
        return self


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
        float,
        About("Largest deviation of a reading.", above=0.0, at_most=1000.0, quantity=NOISE_BOUND, needs=(_NOISE,)),
    ] = 5.0

    def uses(self) -> frozenset[Need]:
        """Noise, if there is any to bound."""
        return frozenset({_NOISE} if self.variance else ())

    def recorded(self) -> None:
        """Leave the noise out: a record has its own."""


class CorrelatedNoiseSettings(SensorPart, name="correlated-noise"):
    """Noise that is correlated from sample to sample, a first-order process."""

    sources = ("breton2008",)
    make: ClassVar = "glucoloop.sensors:correlated_noise"
    variance: Annotated[
        float, About("Variance of the error of each reading.", at_least=0.0, quantity=NOISE_VARIANCE)
    ] = 9.0
    correlation: Annotated[
        float, About("Correlation of the errors of two consecutive readings.", at_least=0.0, below=1.0)
    ] = 0.7


class LagSettings(SensorPart, name="lag"):
    """Glucose behind a first-order lag, as under the skin."""

    sources = ("rebrin1999",)
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

    def recorded(self) -> None:
        """Leave the delay out."""

    def samples(self, sample_time_min: float) -> int:
        """The time as a number of samples; Refusal unless it is a whole number of them."""
        return whole_samples(self.minutes, sample_time_min, "a dead time")

    def made(self, **known: Any) -> Any:
        """The sensor; one without delay where the time is 0."""
        samples = self.samples(known["sample_time_min"])
        return self.made_of({"samples": samples}, known) if samples else known["inner"]


class DisplaySettings(SensorPart, name="cgm-display"):
    """Readings as a continuous glucose monitor shows them: its range, whole steps, one every few minutes."""

    make: ClassVar = "glucoloop.sensors.cgm:display"
    low_mg_dl: Annotated[
        float,
        About("Lower end of the range, which is given for less.", at_least=0.0, at_most=2000.0, quantity=GLUCOSE_BOUND),
    ] = 40.0
    high_mg_dl: Annotated[
        float,
        About("Upper end of the range, which is given for more.", above=0.0, at_most=2000.0, quantity=GLUCOSE_BOUND),
    ] = 400.0
    step_mg_dl: Annotated[float, About("Step of the readings.", above=0.0, at_most=100.0)] = 1.0
    every_min: Annotated[
        float, About("Time between two readings; samples between have none.", above=0.0, at_most=LONGEST_LAG_MIN)
    ] = 5.0

    def __post_init__(self) -> None:
        if not self.low_mg_dl < self.high_mg_dl:
            raise Refusal(
                f"a range of {self.low_mg_dl:g} to {self.high_mg_dl:g} mg/dl is not possible; "
                f"{GLUCOSE_BOUND.looks_like(self.high_mg_dl) or 'give an upper end above the lower one'}"
            )


class MonitorPart(SensorPart):
    """A continuous glucose monitor with the errors of a model."""

    make: ClassVar = "glucoloop.sensors.cgm:monitor"
    model: ClassVar[str] = ""
    """Errors of the sensor, a `sensors.cgm.ErrorModel`, as ``module:attribute``."""
    lag_min: Annotated[
        float | None,
        About(
            "Lag of glucose at the sensor behind that of blood; by default that of the model, and none where the site "
            "is interstitial.",
            at_least=0.0,
            at_most=LONGEST_LAG_MIN,
        ),
    ] = None
    noise: Annotated[bool, About("Whether readings have noise: true or false.")] = True
    drift: Annotated[
        bool, About("Whether readings have the error of calibration, which changes with time: true or false.")
    ] = True
    display: Annotated[
        bool, About("Whether readings are those of a display, as cgm-display has them: true or false.")
    ] = True
    warm_up_min: Annotated[
        float, About("Time after an insertion without readings.", at_least=0.0, at_most=MIN_PER_DAY)
    ] = 120.0
    wear_min: Annotated[
        float,
        About("Time from one insertion to the next, of another sensor.", above=0.0, at_most=_LONGEST_WEAR_MIN),
    ] = 10.0 * MIN_PER_DAY
    worn_min: Annotated[
        float | None,
        About(
            "Time since the insertion at the start; by default drawn for each person, and 0 begins with the warm-up.",
            at_least=0.0,
            at_most=_LONGEST_WEAR_MIN,
        ),
    ] = None

    def __post_init__(self) -> None:
        if self.warm_up_min >= self.wear_min:
            raise Refusal(
                f"warm_up_min is {self.warm_up_min:g} min, but the sensor is replaced after {self.wear_min:g} min, "
                "so that it never has a reading; give less"
            )
        if self.worn_min is not None and self.worn_min >= self.wear_min:
            raise Refusal(
                f"worn_min is {self.worn_min:g} min, but the sensor is replaced after {self.wear_min:g} min; give less"
            )

    def recorded(self) -> SensorPart:
        """Lag of the monitor alone: a model is identified from readings that were corrected with references."""
        return type(self)(lag_min=self.lag_min, noise=False, drift=False, display=False, warm_up_min=0.0)

    def made(self, **known: Any) -> Any:
        """The sensor with the errors of its model."""
        return self.made_of({**self.values(), "model": loaded(self.model)}, known)


class Breton2008Settings(MonitorPart, name="breton-2008"):
    """FreeStyle Navigator, with the errors of Breton and Kovatchev (2008)."""

    sources = ("breton2008",)
    model: ClassVar = "glucoloop.sensors.cgm:BRETON_2008"
    warm_up_min: float = 600.0
    wear_min: float = 5.0 * MIN_PER_DAY


class Facchinetti2014Settings(MonitorPart, name="facchinetti-2014"):
    """Dexcom SEVEN Plus, with the errors of Facchinetti et al. (2014)."""

    sources = ("facchinetti2014",)
    model: ClassVar = "glucoloop.sensors.cgm:FACCHINETTI_2014"
    wear_min: float = 7.0 * MIN_PER_DAY


class DexcomG5Settings(MonitorPart, name="dexcom-g5"):
    """Dexcom G5, with the errors of Vettoretti et al. (2018)."""

    sources = ("vettoretti2018", "facchinetti2014")
    model: ClassVar = "glucoloop.sensors.cgm:DEXCOM_G5"
    wear_min: float = 7.0 * MIN_PER_DAY


class DexcomG6Settings(MonitorPart, name="dexcom-g6"):
    """Dexcom G6, with the mean errors of Vettoretti et al. (EMBC 2019)."""

    sources = ("vettoretti2019g6",)
    model: ClassVar = "glucoloop.sensors.cgm:DEXCOM_G6"


class Vettoretti2019Settings(MonitorPart, name="vettoretti-2019"):
    """Factory-calibrated sensors that differ, drawn for each person and wear, of Vettoretti et al. (Sensors 2019)."""

    sources = ("vettoretti2019",)
    model: ClassVar = "glucoloop.sensors.cgm:VETTORETTI_2019"


SENSORS: Final = Catalogue(
    SensorPart,
    (
        IdealSettings,
        WhiteNoiseSettings,
        CorrelatedNoiseSettings,
        LagSettings,
        DeadTimeSettings,
        Breton2008Settings,
        Facchinetti2014Settings,
        DexcomG5Settings,
        DexcomG6Settings,
        Vettoretti2019Settings,
        DisplaySettings,
    ),
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
