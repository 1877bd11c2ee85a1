"""The declaration of a controller: what studies, designs and reports have to know of it without designing it.

A controller is one file with its declaration, a class of settings. It is the controller itself, with methods `init` and
`step`, or its method `designed` makes one from models of the patient. Here is what declarations share.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import KW_ONLY
from typing import Annotated, Any, ClassVar, Final, Self

from glucoloop._lazy_jax import jax, jnp
from glucoloop.arguments import is_traced
from glucoloop.component.effects import (
    BOLUSES,
    CHANCE,
    DOSES_BY_PROFILE,
    FORECASTS,
    INDIVIDUAL,
    MEALS,
    MEALS_ANNOUNCED,
    TIME_OF_DAY,
    Need,
)
from glucoloop.component.pytree_component import DATA, HOST, STATIC, PytreeComponent, derived, wired
from glucoloop.component.routes import ROUTES
from glucoloop.component.setting import About, Tuned
from glucoloop.control.design_case import DesignCase, check_rate, check_sample_time
from glucoloop.pumps.limits import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS, BolusLimits, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.sensors.delay import LONGEST_LAG_MIN
from glucoloop.therapy import Profile
from glucoloop.unit_guess import (
    ANY_SETTING,
    CARB_RATIO,
    CORRECTION,
    FITTED_STEP,
    INSULIN_RATE,
    LAG,
    refuse_unusual,
)

_TUNED = ("move_horizon", "prediction_horizon", "output_weight", "move_weight")


SensorLag = Annotated[
    float,
    About(
        "First-order lag of the sensor behind glucose that the estimator knows of, in minutes; 0: none.",
        at_least=0.0,
        at_most=LONGEST_LAG_MIN,
        quantity=LAG,
    ),
]
FittedStep = Annotated[
    float,
    About(
        "Lasting step of insulin to which the first-order model is fitted, in mU/min; "
        "0: 11.165, or half the basal rate where that is less.",
        at_least=0.0,
        quantity=FITTED_STEP,
    ),
]
FLOOR: Final = Need("glucose_floor_mg_dl is 0, so that there is no floor")
CAUTION: Final = Need("caution_weight is 0")
FOR_MEALS: Final = (MEALS, MEALS_ANNOUNCED)
"""Needs of a setting that is for announced meals."""
CarbRatio = Annotated[
    float,
    About(
        "Carbohydrate that 1 U covers, in g; 0: of the person's profile, or 500 over the total daily dose.",
        at_least=0.0,
        quantity=CARB_RATIO,
        needs=FOR_MEALS,
    ),
]
MealShare = Annotated[
    float,
    About(
        "Share of the bolus for an announced meal that is given; 0: none.", at_least=0.0, at_most=2.0, needs=FOR_MEALS
    ),
]
CorrectionFactor = Annotated[
    float,
    About(
        "Fall of glucose by 1 U, in mg/dl; 0: of the person's profile, or 1800 over the total daily dose.",
        at_least=0.0,
        quantity=CORRECTION,
    ),
]


class ControllerComponent(PytreeComponent):
    """Declaration of a controller.

    A controller joins every command by one class, entered in `control.catalogue.CONTROLLERS` or by the entry point of
    another package in the group ``glucoloop.controllers``.

    Raises
    ------
    TypeError
        For a place that is not written as ``module:function``, or a tunable controller without horizons and weights.
    """

    kind: ClassVar = "controller"
    any_number: ClassVar = ANY_SETTING
    uses_model: ClassVar[bool] = True
    """Whether it is designed on an identified model; if not, none is identified for it."""
    on_equations: ClassVar[bool] = True
    """Whether it is designed on equations of the patient or a model identified from them, which nobody has of a person;
    otherwise it knows a profile alone."""
    individual: ClassVar[str | None] = "glucoloop.build.individual:one_by_one"
    """Place ``module:function`` of the design for each person of a trial, see
    `build.individual.individual_design`; None for a controller that is the same for all people."""
    tunable: ClassVar[bool] = False
    """Whether `glucoloop tune` tries a grid of it: it has the settings of a predictive controller, and `horizons` and
    `padded` as `control.LinearMPC` has them."""
    reference_filters: ClassVar[str | None] = None
    """Range of the setting ``reference_filter`` that `glucoloop tune` tries unless another one is given, like
    ``.3:.8:.05``; without it, the default value alone."""
    gives_boluses: ClassVar[bool] = False
    """Whether it decides on boluses too; the controller then has ``gives_boluses = True`` as well."""
    used: ClassVar[frozenset[Need]] = DOSES_BY_PROFILE | {TIME_OF_DAY, CHANCE}
    """Needs that it meets, by what it uses; one that does not say it is taken to use everything."""
    slow: ClassVar[bool] = False
    """Whether it takes long to compile, up to half a minute, and some twenty times as long as linear MPC to decide, so
    that studies of many loops use fewer and shorter ones with it."""
    searched: ClassVar[tuple[Tuned, ...]] = ()
    """Settings that `glucoloop robust` can search, with their default ranges."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        for place in filter(None, (cls.individual,)):
            if not all(place.partition(":")):
                raise TypeError(f"{place!r} of the controller {cls.name} is no place; write it like module:function")
        if cls.tunable and not hasattr(cls, "move_horizon"):
            raise TypeError(f"the controller {cls.name} cannot be tunable: it lacks one of {', '.join(_TUNED)}")

    @classmethod
    def defaults_of_route(cls, insulin_route: str) -> Mapping[str, Any]:
        """Default settings for a route of insulin, where they differ from the defaults, for readings without noise."""
        return {name: default.noise_free for name, default in ROUTES[insulin_route].tunings.get(cls.name, {}).items()}

    def uses(self) -> frozenset[Need]:
        """Needs that a controller with these settings meets; boluses and a design for each person are two of them.

        One whose class is not the controller itself may make forecasts, and so may have a use for them.
        """
        forecasts = frozenset({FORECASTS} if hasattr(self, "forecast") or not hasattr(self, "step") else ())
        boluses = frozenset({BOLUSES}) if self.gives_boluses else frozenset()
        floor = frozenset({FLOOR} if getattr(self, "glucose_floor_mg_dl", 0.0) else ())
        individual = frozenset(() if self.individual is None else {INDIVIDUAL})
        return self.used | boluses | floor | individual | forecasts

    def designed(self, case: Any) -> Any:
        """The controller for a `control.design_case.DesignCase`, or a Refusal; designing imports JAX.

        By default it is the declaration itself, with the facts of the case that it has fields for.
        """
        return self.made(
            limits=case.limits, bolus=case.bolus, profile=case.profile, sample_time_min=case.sample_time_min
        )


class ByProfile(ControllerComponent):
    """Declaration of a controller that doses by the profile of a person and gives boluses."""

    uses_model: ClassVar = False
    on_equations: ClassVar = False
    individual: ClassVar = "glucoloop.build.individual:by_profile"
    gives_boluses: ClassVar = True
    used: ClassVar = DOSES_BY_PROFILE


class OfPerson(ByProfile):
    """A controller by profile that is its own declaration: it is connected to a person and to a pump."""

    _: KW_ONLY
    profile: Profile | None = wired(HOST, default=None)
    limits: DoseLimits = wired(DATA, default=PARKER_1999_LIMITS)
    bolus: BolusLimits = wired(DATA, default=DEFAULT_BOLUS_LIMITS)
    sample_time_min: float = wired(STATIC, default=5.0)
    past_basal_mU_min: Any | None = wired(DATA, default=None)
    """Basal rate of a schedule that held since the last sample, or None for the basal rate."""

    def of_person(
        self,
        profile: Profile,
        limits: DoseLimits = PARKER_1999_LIMITS,
        *,
        bolus: BolusLimits = DEFAULT_BOLUS_LIMITS,
        sample_time_min: float = 5.0,
        allow_unusual: bool = False,
    ) -> Self:
        """The controller for a person and a pump.

        Parameters
        ----------
        profile : Profile
            The person's basal rate, and what else is known; what is not follows from the basal rate.
        limits : DoseLimits
            Limits of the basal rate.
        bolus : BolusLimits
            Limits of the pump; no larger bolus is requested.
        allow_unusual : bool
            Whether a basal rate or a setting is accepted that looks like another unit.

        Raises
        ------
        ValueError
            For a basal rate outside the limits, a sample time that is not possible, or an implausible value.
        """
        check_sample_time(sample_time_min)
        check_rate("basal", profile.basal_mU_min, limits)
        if not allow_unusual:
            self._refuse_unusual(profile.basal_mU_min)
        controller: Self = self.made(profile=profile, limits=limits, bolus=bolus, sample_time_min=sample_time_min)
        return controller

    def designed(self, case: DesignCase) -> Self:
        """The controller for the person of a case."""
        return self.of_person(
            case.profile,
            case.limits,
            bolus=case.bolus,
            sample_time_min=case.sample_time_min,
            allow_unusual=True,  # which is asked about where the settings are read
        )

    def _refuse_unusual(self, basal_mU_min: Any) -> None:
        amounts = {"basal_mU_min": (basal_mU_min, INSULIN_RATE)}
        for name, value in self.explicit.items():
            quantity = self.setting(name).about.quantity
            if quantity is not None and value:
                amounts[name] = (value, quantity)
        for name, (value, quantity) in amounts.items():
            if not is_traced(value):
                refuse_unusual(float(value), quantity, name)

    def with_profile(self, profile: Profile) -> Self:
        """The same controller for a person with the given profile; settings that were given stay as they are."""
        basal = jnp.asarray(profile.basal_mU_min)
        known = dataclasses.replace(profile, basal_mU_min=basal)
        return self.made(profile=known, past_basal_mU_min=profile.past_basal_mU_min)  # type: ignore[no-any-return]

    def with_basal(self, insulin_mU_min: jax.Array) -> Self:
        """The same controller for a person of whom the basal rate alone is known."""
        return self.with_profile(Profile(basal_mU_min=insulin_mU_min, setpoint_mg_dl=jnp.nan))

    @derived
    def basal_mU_min(self) -> Any:
        """The person's basal rate."""
        return self._person.basal_mU_min

    @property
    def basal_since_mU_min(self) -> Any:
        """Basal rate that held since the last sample."""
        return self.basal_mU_min if self.past_basal_mU_min is None else self.past_basal_mU_min

    @property
    def _person(self) -> Profile:
        if self.profile is None:
            raise Refusal(f"the controller {self.name} doses by the profile of a person; give it one with of_person")
        return self.profile
