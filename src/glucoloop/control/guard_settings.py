"""Settings of a guard: readings that it accepts, times that it waits, and doses that it allows.

Nothing here imports a numerical library.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, Protocol

from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import DOSES_BY_PROFILE, GLUCAGON, PROFILE, READINGS, Need
from glucoloop.component.request import Request, completed, request_of
from glucoloop.component.routes import INTRAVENOUS, SUBCUTANEOUS, route_of
from glucoloop.component.setting import About
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import (
    ACTION_TIME,
    ANY_SETTING,
    GLUCOSE_BOUND,
    GLUCOSE_ERROR,
    GLUCOSE_FALL,
    GLUCOSE_RISE,
    WAITING_TIME,
)

_bounded: Final = functools.partial(About, at_most=10_000.0)  # no result of so large a value overflows
_limit: Final = functools.partial(_bounded, at_least=0.0)
_waiting: Final = functools.partial(_limit, quantity=WAITING_TIME)
_positive: Final = functools.partial(_bounded, above=0.0)
_one_or_more: Final = functools.partial(_bounded, at_least=1.0)


OF_ROUTE: Final[dict[str, dict[str, float]]] = {
    INTRAVENOUS: {},
    # A total daily dose is taken for 48 basal hours, since half of it is basal. By the rules of 500 and 1800 a gram of
    # carbohydrate then needs 0.096 basal hours, and a basal hour lowers glucose by 37.5 mg/dl.
    SUBCUTANEOUS: {
        # Insulin comes late, so that a meal meets none: after 100 g without a bolus half of the people of `boiroux2017`
        # rise by more than 5.2 mg/dl/min at their fastest, and 99 of 100 by less than 9.8.
        "fastest_mg_dl_min": 10.0,
        # 5 % of a dose are left after 6 h, the duration of action that Loop and the pumps' calculators use (5 to 7 h).
        "on_board_tau_min": 120.0,
        # Ten basal hours: the bolus for 70 g and three basal hours more, a bound like max_iob of open-source systems.
        "max_on_board": 5.0,
        # All of it at once, beside the basal rate.
        "max_hour": 11.0,
        # One basal rate on board is 2 basal hours.
        "fall_mg_dl": 75.0,
        # Insulin works for hours: 60 min, and not 40, before a low halves the people who go below 54 mg/dl on boluses.
        "ahead_min": 60.0,
        # From person to person the titrated ratio is .3 to 1.7 times that of the rule, and the factor .4 to 1.2 times.
        "profile_span": 3.0,
    },
}
"""Default settings by route of insulin, where they differ from the setting's own default, which is for a vein."""


class GuardSettings(Component, name="usual"):
    """Limits on readings, times and doses around any controller.

    See `control.guarded`. Values without a source were chosen by the experiments of the guide.

    The defaults are for intravenous insulin; `for_route` gives those for subcutaneous insulin. Their sources:

    - readings: sensors give 40 to 400 mg/dl, meters 20 to 600;
    - fastest rise, against the last accepted reading: healthy people pass 2 mg/dl/min in about 1 % of the time
      (doi:10.1177/15209156251390822); a fall may be twice as fast;
    - unchanged readings, after 10 min: a search for the worst sensor errors makes a reading high and stuck;
    - no bolus after 20 min: as long as Control-IQ (Tandem) goes on without readings; a part of the basal rate after
      90 min: as long as the MiniMed 670G (Medtronic) stays in its own fallback, and less than the 2 h for which its
      suspension may last;
    - suspension: Basal-IQ (Tandem) takes 80 mg/dl, too near to a setpoint of 81, and 70 for glucose now, and looks
      30 min ahead; with 40 fewer people went low after an occlusion;
    - dose in an hour: OpenAPS allows 3 times the largest basal rate of the day; the paper's pump gives at most 2.6
      times the nominal one;
    - glucagon in a day: 1 mg is the largest that is recommended (doi:10.1177/1932296819879093); in an hour: the largest
      of the doses of Haymond et al. (2016, doi:10.2337/dc15-2124); none above the setpoint, and none on a reading that
      is not accepted;
    - insulin on board: the time constant of glucose after a step of insulin is 89 min, and glucose of the nominal
      patient falls by 77 mg/dl, in the end, under twice the basal rate.
    """

    kind: ClassVar = "guard"
    any_number: ClassVar = ANY_SETTING

    lowest_reading_mg_dl: Annotated[float, _limit("Lowest reading that the guard accepts.", quantity=GLUCOSE_BOUND)] = (
        20.0
    )
    highest_reading_mg_dl: Annotated[
        float, _positive("Highest reading that the guard accepts.", quantity=GLUCOSE_BOUND)
    ] = 600.0
    fastest_mg_dl_min: Annotated[
        float, _positive("Fastest rise of a reading that the guard accepts.", quantity=GLUCOSE_RISE)
    ] = 3.0
    stuck_min: Annotated[
        float,
        _positive("Minutes after which an unchanged reading is rejected while much or little insulin is on board."),
    ] = 20.0
    stuck_on_board: Annotated[
        float, _limit("Insulin on board, above or below that of the basal rate, that counts for this; in basal rates.")
    ] = 0.25
    unchanged_min: Annotated[
        float, _waiting("Minutes for which a reading may stay unchanged before at most the basal rate is given.")
    ] = 10.0
    gap_min: Annotated[
        float, _waiting("Minutes without an accepted reading after which no bolus is given, not for a meal either.")
    ] = 20.0
    long_gap_min: Annotated[
        float, _waiting("Minutes without an accepted reading after which a part of the basal rate is given.")
    ] = 90.0
    reduced_fraction: Annotated[float, _limit("Part of the basal rate that is given then.", at_most=1.0)] = 0.5
    low_mg_dl: Annotated[
        float, _limit("Predicted glucose below which insulin is suspended.", quantity=GLUCOSE_BOUND)
    ] = 65.0
    ahead_min: Annotated[float, _waiting("Time of this prediction.")] = 40.0
    hysteresis_mg_dl: Annotated[
        float, _limit("Distance above that bound from which insulin is given again.", quantity=GLUCOSE_ERROR)
    ] = 5.0
    max_hour: Annotated[float, _one_or_more("Largest dose in an hour, in basal hours.")] = 2.4
    max_on_board: Annotated[float, _limit("Largest insulin on board beyond the basal rate, as a multiple of it.")] = 1.3
    on_board_tau_min: Annotated[
        float, _one_or_more("Time constant with which insulin on board decays.", quantity=ACTION_TIME)
    ] = 90.0
    fall_mg_dl: Annotated[
        float,
        _one_or_more("Glucose above the setpoint for which one basal rate may be on board.", quantity=GLUCOSE_FALL),
    ] = 60.0
    error_mg_dl: Annotated[float, _limit("Sensor error for which no insulin is added.", quantity=GLUCOSE_ERROR)] = 5.0
    always_basal: Annotated[float, _one_or_more("Multiple of the basal rate that is allowed at any reading.")] = 1.2
    doubt_tau_min: Annotated[float, _positive("Time constant with which a jump of the reading is forgotten.")] = 480.0
    profile_span: Annotated[
        float,
        _one_or_more(
            "Largest factor by which a person's own ratio and correction factor change the limits of insulin; 1 for "
            "those of the basal rate alone."
        ),
    ] = 1.0

    max_glucagon_hour_ug: Annotated[
        float, _limit("Most glucagon in any hour, of a controller that gives it.", needs=(GLUCAGON,))
    ] = 300.0
    max_glucagon_day_ug: Annotated[
        float, _limit("Most glucagon in any 24 hours, of a controller that gives it.", needs=(GLUCAGON,))
    ] = 1000.0

    def uses(self) -> frozenset[Need]:
        """A guard uses readings, and the profile of a person in its limits."""
        return frozenset({READINGS, PROFILE})

    @classmethod
    def for_route(cls, insulin_route: str) -> GuardSettings:
        """Default limits for a route of insulin, ``"intravenous"`` or ``"subcutaneous"``; see `OF_ROUTE` for sources.

        Raises
        ------
        ValueError
            For an unknown route.
        """
        route_of(insulin_route)
        return cls(**OF_ROUTE[insulin_route])

    @classmethod
    def defaults_of_route(cls, insulin_route: str) -> Mapping[str, Any]:
        """Default limits for a route of insulin, where they differ from the defaults."""
        return OF_ROUTE[insulin_route]

    def __post_init__(self) -> None:
        from glucoloop.arguments import ArgumentTypeError, is_traced

        for field in dataclasses.fields(self):
            if is_traced(getattr(self, field.name)):
                raise ArgumentTypeError(
                    f"{field.name} is traced by JAX, but the settings of a guard are part of the compiled program; "
                    "give plain numbers, outside of the transformation"
                )
        if not self.lowest_reading_mg_dl < self.highest_reading_mg_dl:
            raise Refusal(
                f"readings from {self.lowest_reading_mg_dl:g} to {self.highest_reading_mg_dl:g} mg/dl are no range; "
                "give a highest_reading_mg_dl above lowest_reading_mg_dl"
            )
        if not self.gap_min <= self.long_gap_min:
            raise Refusal(
                f"a guard's long_gap_min of {self.long_gap_min:g} is less than its gap_min of {self.gap_min:g}; "
                "give as much or more"
            )


class ForecastSettings(GuardSettings, name="forecast"):
    """The limits of the usual guard, and a forecast that every dose passes; for subcutaneous insulin.

    A dose passes as far as glucose stays above a floor by a cautious forecast if no insulin follows it; see
    `control.guard_forecast`. Insulin that is withheld, of an announced meal or of the basal rate, is offered again for
    some time.
    """

    floor_mg_dl: Annotated[float, _limit("Floor under the cautious forecast of glucose.", quantity=GLUCOSE_BOUND)] = (
        70.0
    )
    forecast_min: Annotated[float, _waiting("Time of this forecast.", at_most=480.0)] = 300.0
    basal_above_mg_dl: Annotated[
        float, _limit("Reading above which the forecast does not take the basal rate away.", quantity=GLUCOSE_BOUND)
    ] = 180.0
    owed_min: Annotated[
        float,
        About(
            "Time for which withheld insulin of a meal is offered again, and time constant with which withheld basal "
            "insulin is forgotten.",
            above=0.0,
            at_most=10_000.0,
            quantity=WAITING_TIME,
        ),
    ] = 240.0
    ceiling_mg_dl: Annotated[
        float,
        _positive("Highest reading that a sensor shows; there a reading may stay the same.", quantity=GLUCOSE_BOUND),
    ] = 400.0

    def uses(self) -> frozenset[Need]:
        """Needs that the guard meets; its forecast goes by announced meals, ratio and factor too."""
        return DOSES_BY_PROFILE

    @classmethod
    def for_route(cls, insulin_route: str) -> ForecastSettings:
        """Default limits for subcutaneous insulin; another route is refused, since the forecast is of no other."""
        cls.refuse_route(insulin_route)
        return cls(**cls.defaults_of_route(insulin_route))

    @classmethod
    def defaults_of_route(cls, insulin_route: str) -> Mapping[str, Any]:
        """Default limits for a route of insulin, where they differ from the defaults.

        The trend is followed for half the time, since the forecast sees lows that come later: 30 min in place of 60
        keep 1.6 points more of the time in range (100 people of hovorka) and bring nobody else below 54 mg/dl.
        """
        return {**super().defaults_of_route(insulin_route), "ahead_min": 30.0}

    @classmethod
    def refuse_route(cls, insulin_route: str) -> None:
        """Refuse a route of insulin but the subcutaneous one."""
        if insulin_route != SUBCUTANEOUS:
            raise Refusal(
                f"the guard {cls.name} forecasts subcutaneous insulin, and this insulin is {insulin_route}",
                "give the guard usual, or a patient of subcutaneous insulin like --patient hovorka-2004",
            )


GUARDS: Final = Catalogue(
    GuardSettings,
    {
        "usual": "glucoloop.control.guard_settings:GuardSettings",
        "forecast": "glucoloop.control.guard_settings:ForecastSettings",
    },
    example="usual, max_hour=2",
    unnamed=True,
)


class Guarded(Protocol):
    """Declaration of a patient, as far as a guard depends on it."""

    insulin_route: ClassVar[str]
    guard: ClassVar[Mapping[str, float]]


def guard_of(
    patient: Guarded | type[Guarded], guard: GuardSettings | Request[GuardSettings] | None = None
) -> GuardSettings:
    """A guard with the defaults of a patient, in place of the settings that are not explicit."""
    asked = request_of(guard or Request(GuardSettings))
    settings = completed(asked, {**asked.component.defaults_of_route(patient.insulin_route), **patient.guard})
    if isinstance(settings, ForecastSettings):
        settings.refuse_route(patient.insulin_route)
    return settings
