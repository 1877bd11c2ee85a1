"""Pumps: name and settings of each, its limits, and the place of the function that makes it.

A pump joins every command by one class, entered in `PUMPS` or by the entry point of another package in the group
``glucoloop.pumps``.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, Literal

from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import BOLUSES
from glucoloop.component.part import MadePart
from glucoloop.component.setting import About, known_names
from glucoloop.faults import Least, Step
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import BOLUS_STEP, LARGEST_BOLUS, RATE_STEP
from glucoloop.units import MIN_PER_DAY

LongActing = Literal["glargine", "glargine-u300", "detemir", "degludec"]

_limit: Final = functools.partial(About, at_most=10_000.0)
_LONGEST_WEAR_MIN: Final = 30.0 * MIN_PER_DAY
_bolus: Final = functools.partial(About, at_most=1000.0, needs=(BOLUSES,))


class PumpPart(MadePart):
    """Declaration of a pump.

    Its function is also given, if it has parameters of these names, ``inner`` (a pump that only keeps the limits of the
    run), ``limits`` (`pumps.DoseLimits`), ``bolus`` (`pumps.BolusLimits`) and ``sample_time_min``.
    """

    kind: ClassVar = "pump"
    limits: ClassVar[Mapping[str, float]] = {}
    """Limits of the pump by setting, where they are not those usual for the patient. With this pump they are the
    defaults of a run, so that controllers, guard and metrics know them."""

    max_change_mU_min: Annotated[
        float | None,
        _limit("Largest change of the rate from one sample to the next; that of the patient's pump.", above=0.0),
    ] = None
    min_insulin_mU_min: Annotated[
        float | None, _limit("Least rate of the pump; that of the patient's pump.", at_least=0.0)
    ] = None
    max_insulin_mU_min: Annotated[
        float | None, _limit("Greatest rate of the pump; that of the patient's pump.", above=0.0)
    ] = None
    resolution_mU_min: Annotated[
        float | None, _limit("Smallest step of the rate; any rate by default.", above=0.0, quantity=RATE_STEP)
    ] = None
    max_bolus_U: Annotated[float, _bolus("Largest bolus of the pump.", above=0.0, quantity=LARGEST_BOLUS)] = 25.0
    min_bolus_U: Annotated[
        float, _bolus("Least bolus that the pump gives; a smaller one is not given.", at_least=0.0, quantity=BOLUS_STEP)
    ] = 0.05
    bolus_step_U: Annotated[
        float, _bolus("Step of a bolus, which is rounded down to whole ones.", above=0.0, quantity=BOLUS_STEP)
    ] = 0.05

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        for key in cls.limits:
            if key not in PumpPart.settings():
                raise TypeError(f"the pump {cls.name} has a limit {key!r}; {known_names(key, PumpPart.settings())}")

    def made(self, **known: Any) -> Any:
        """The pump, made of its own settings; the limits of all pumps are kept by the one inside."""
        return self.made_of({name: self.values()[name] for name in self.settings().keys() - PumpPart.settings()}, known)


class LimitedSettings(PumpPart, name="limited"):
    """Keeps its limits."""

    make: ClassVar = "glucoloop.pumps:LimitedPump"


class ResolutionPumpSettings(PumpPart, name="resolution"):
    """Delivers whole steps of the rate, and the remainder later."""

    make: ClassVar = "glucoloop.pumps:with_resolution"
    step_mU_min: Step = 0.5
    least_mU_min: Least = 0.0


class ExpiringSettings(PumpPart, name="expiring"):
    """Returns to the basal rate if no command arrives for some samples."""

    make: ClassVar = "glucoloop.pumps:expiring"
    samples: Annotated[
        int, About("Samples for which a command holds, the one in which it arrives included.", at_least=1)
    ] = 2


class InfusionSetSettings(PumpPart, name="infusion-set"):
    """Loses more insulin the longer its infusion set is worn, until it is changed."""

    make: ClassVar = "glucoloop.pumps:infusion_set"
    wear_min: Annotated[
        float, About("Time from one change of the set to the next.", above=0.0, at_most=_LONGEST_WEAR_MIN)
    ] = 3.0 * MIN_PER_DAY
    sound_min: Annotated[
        float, About("Time after a change in which nothing is lost.", at_least=0.0, at_most=_LONGEST_WEAR_MIN)
    ] = 1.5 * MIN_PER_DAY
    loss_pct: Annotated[
        float,
        About("Part of the insulin that is lost at the end of the wear.", at_least=0.0, at_most=100.0),
    ] = 20.0
    worn_min: Annotated[
        float | None,
        About(
            "Time since the change at the start; by default drawn for each person.",
            at_least=0.0,
            at_most=_LONGEST_WEAR_MIN,
        ),
    ] = None

    def __post_init__(self) -> None:
        for name in ("sound_min", "worn_min"):
            minutes = getattr(self, name)
            if minutes is not None and minutes >= self.wear_min:
                raise Refusal(
                    f"{name} is {minutes:g} min, but the set is changed after {self.wear_min:g} min; give less"
                )


class PenSettings(PumpPart, name="pen"):
    """Pens: the basal rate is injected as long-acting insulin, and boluses in steps of half a unit."""

    make: ClassVar = "glucoloop.pumps:pen"

    min_bolus_U: float = 0.5
    bolus_step_U: float = 0.5
    insulin: Annotated[LongActing, About("Long-acting insulin.")] = "glargine"
    injections: Annotated[int, About("Injections of it a day, at even distances.", at_least=1, at_most=4)] = 1
    at_min: Annotated[
        float,
        About("Time of one of the daily injections, from the start; 22h.", at_least=0.0, below=MIN_PER_DAY),
    ] = 1320.0
    dose_step_U: Annotated[
        float,
        About("Step to which a long-acting dose is rounded.", above=0.0, at_most=10.0, quantity=BOLUS_STEP),
    ] = 0.5
    dose_U_kg: Annotated[
        float,
        About("Daily dose in U for each kg, from which the duration of the action follows.", above=0.0, at_most=3.0),
    ] = 0.25


PUMPS: Final = Catalogue(
    PumpPart,
    (LimitedSettings, ResolutionPumpSettings, ExpiringSettings, InfusionSetSettings, PenSettings),
    example="expiring, samples=3",
    unnamed=True,
)
