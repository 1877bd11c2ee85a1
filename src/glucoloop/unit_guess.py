"""Plausible ranges of values, outside of which a value is possible but probably in another unit.

A bound excludes the impossible and is always enforced. A plausible range is narrower: a value outside it is asked about
in an error that names the unit it looks like, and is accepted once the user confirms it.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.units import OTHER_UNITS

CONFIRM_OPTION: Final = "add --allow-unusual"
"""Way to confirm a value on the command line, wherever it stands."""
CONFIRM_ARGUMENT: Final = "pass allow_unusual=True"
"""Way to confirm a value in Python."""


@dataclass(frozen=True)
class OtherUnit:
    """A unit in which a quantity is often given by mistake."""

    name: str
    factor: float
    """Factor from this unit to the quantity's own unit."""


@dataclass(frozen=True)
class Quantity:
    """A measured quantity, its unit, and its plausible range, whose minimum value is below its maximum."""

    name: str
    unit: str
    least: float
    most: float
    others: tuple[OtherUnit, ...] = ()
    """Other units in use, the likeliest first."""
    zero: bool = False
    """Whether 0 is plausible too, as for a noise or a dead time."""
    reason: str = ""
    """Reason for the range, where the name does not make it plain: a part of a sentence."""

    def __post_init__(self) -> None:
        if not self.least < self.most:
            raise Refusal(
                f"the plausible range of {self.name} from {self.least:g} to {self.most:g} {self.unit} is empty; "
                "give a lower bound below the upper one"
            )

    def plausible(self, value: float) -> bool:
        """Whether the value is plausible; NaN is not."""
        return self.least <= value <= self.most or (self.zero and value == 0.0)

    def meant(self, value: float) -> Iterator[tuple[OtherUnit, float]]:
        """The other units in which the value would be plausible, each with the value in the quantity's own unit."""
        if abs(value) > sys.float_info.max:  # a whole number beyond all floats
            return
        for other in self.others:
            converted = value * other.factor
            if value != 0.0 and self.plausible(converted):
                yield other, converted

    def looks_like(self, value: float) -> str | None:
        """Unit that a value looks like, as in ``that looks like mmol/l: 5.5 mmol/l is 99.1 mg/dl``, if any."""
        result = next(self.meant(value), None)
        if result is None:
            return None
        other, converted = result
        return f"that looks like {other.name}: {value:g} {other.name} is {_rounded(converted)} {self.unit}"

    def within(self, *, least: float | None = None, most: float | None = None, reason: str) -> Quantity:
        """The same quantity with a narrower range, for a place where more is known."""
        return dataclasses.replace(
            self,
            least=self.least if least is None else least,
            most=self.most if most is None else most,
            reason=reason,
        )


def others_of(unit: str, *names: str) -> tuple[OtherUnit, ...]:
    """Other units of a unit, by name."""
    return tuple(OtherUnit(name, OTHER_UNITS[unit][name]) for name in names)


_MMOL: Final = others_of("mg/dl", "mmol/l")
_RATES: Final = others_of("mU/min", "U/h", "mU/h")
_SECONDS_OR_HOURS: Final = others_of("min", "s", "h")
_HOURS: Final = others_of("min", "h")
_MU: Final = others_of("U", "mU")

SETPOINT: Final = Quantity("a setpoint", "mg/dl", 50.0, 250.0, _MMOL)
GLUCOSE: Final = Quantity("glucose", "mg/dl", 35.0, 600.0, _MMOL)
GLUCOSE_BOUND: Final = Quantity("a bound on glucose", "mg/dl", 20.0, 1000.0, _MMOL, zero=True)
INSULIN_RATE: Final = Quantity("an insulin rate", "mU/min", 4.0, 500.0, _RATES, zero=True)
LARGEST_RATE: Final = Quantity(
    "the maximum rate of a pump", "mU/min", 8.0, 300.0, (*_RATES, *others_of("mU/min", "pmol/min"))
)
LARGEST_SUBCUTANEOUS_RATE: Final = dataclasses.replace(LARGEST_RATE, most=600.0)
"""The same under the skin, where pumps give up to 35 U/h."""
MIN_RATE: Final = Quantity("the minimum rate of a pump", "mU/min", 0.0, 100.0, others_of("mU/min", "mU/h", "pmol/min"))
RATE_CHANGE: Final = Quantity("the largest change of a rate", "mU/min", 2.0, 500.0, _RATES)
FITTED_STEP: Final = Quantity("a lasting step of a rate", "mU/min", 1.0, 500.0, _RATES, zero=True)
RATE_STEP: Final = Quantity("the smallest step of a rate", "mU/min", 0.2, 20.0, _RATES)
MEAL: Final = Quantity("a meal", "g", 1.0, 300.0, others_of("g", "mg", "kg"))
SAMPLE_TIME: Final = Quantity("a sample time", "min", 0.25, 30.0, _SECONDS_OR_HOURS)
DEAD_TIME: Final = Quantity("a dead time", "min", 0.5, 60.0, _SECONDS_OR_HOURS, zero=True)
DURATION: Final = Quantity("the length of a run", "min", 30.0, 366.0 * 1440.0, _HOURS)
NOISE_VARIANCE: Final = Quantity("the variance of noise on readings", "(mg/dl)²", 0.0, 900.0)
PID_GAIN: Final = Quantity("the gain of a PID controller", "mU/min per mg/dl", 0.001, 100.0, zero=True)
CARB_RATIO: Final = Quantity("a carbohydrate ratio", "g per U", 1.0, 150.0, zero=True)
CORRECTION: Final = Quantity(
    "a correction factor", "mg/dl per U", 8.0, 400.0, others_of("mg/dl per U", "mmol/l per U"), zero=True
)
LARGEST_BOLUS: Final = Quantity("the largest bolus of a pump", "U", 0.1, 100.0, _MU)
BOLUS_STEP: Final = Quantity("the minimum bolus of a pump, or its step,", "U", 0.001, 5.0, _MU, zero=True)
LAG: Final = Quantity("the lag of a sensor", "min", 0.5, 60.0, _SECONDS_OR_HOURS, zero=True)
ACTION_TIME: Final = Quantity("the time for which insulin acts", "min", 15.0, 900.0, _HOURS)
WAITING_TIME: Final = Quantity("the time for which a guard waits", "min", 1.0, 600.0, _SECONDS_OR_HOURS, zero=True)
GLUCOSE_RISE: Final = Quantity(
    "the fastest rise of a reading",
    "mg/dl per min",
    0.4,
    30.0,
    others_of("mg/dl per min", "mmol/l per min", "mg/dl per h"),
)
GLUCOSE_ERROR: Final = Quantity("a difference of glucose", "mg/dl", 1.0, 300.0, _MMOL, zero=True)
GLUCOSE_FALL: Final = Quantity("glucose above the setpoint", "mg/dl", 10.0, 500.0, _MMOL)
ANY_SETTING: Final = Quantity("the number of a setting", "", -1e6, 1e6)
NOISE_BOUND: Final = Quantity("the largest deviation of a reading", "mg/dl", 0.7, 1000.0, _MMOL)


def doubt_about(value: float, quantity: Quantity, called: str, confirm: str = CONFIRM_ARGUMENT) -> Refusal | None:
    """Refusal of an implausible value, or None for a plausible one.

    `called` is the name of the value for the user, and `confirm` the way to confirm it.
    """
    if quantity.plausible(value):
        return None
    amount = f"{value:g} {quantity.unit}".rstrip()
    confirmed = f"{confirm} if {amount} is meant"
    because = f", but {quantity.reason}" if quantity.reason else ""
    for _, converted in quantity.meant(value):
        problem = f"{called} is {amount}{because}; {quantity.looks_like(value)}."
        return Refusal(problem, f"give {_rounded(converted)}", confirmed)
    if quantity.reason:
        return Refusal(f"{called} is {amount}{because}.", "give another value", confirmed)
    usual = f"from {quantity.least:g} to {quantity.most:g} {quantity.unit}".rstrip()
    problem = f"{called} is {amount}; {quantity.name} is usually {usual}."
    return Refusal(problem, "give such a value", confirmed)


def refuse_unusual(value: float, quantity: Quantity, called: str, confirm: str = CONFIRM_ARGUMENT) -> None:
    """Refuse an implausible value, see `doubt_about`."""
    doubt = doubt_about(value, quantity, called, confirm)
    if doubt is not None:
        raise doubt


def _rounded(value: float) -> str:
    """Three digits, which are enough to recognise a value and to give it again."""
    return f"{value:.0f}" if math.fabs(value) >= 100.0 else f"{value:.3g}"
