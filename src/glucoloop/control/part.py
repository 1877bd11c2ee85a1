"""The declaration of a controller: what studies, designs and reports have to know of it without designing it.

A controller is one file with its declaration, a class of settings whose method `designed` makes the controller. Here is
what declarations share.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from glucoloop.component.effects import (
    AHEAD,
    ANNOUNCEMENTS,
    BOLUSES,
    CHANCE,
    DOSES_BY_PROFILE,
    INDIVIDUAL,
    PROFILE,
    READINGS,
    TIME_OF_DAY,
    Need,
)
from glucoloop.component.part import Part
from glucoloop.component.ranges import Tuned
from glucoloop.component.routes import ROUTES
from glucoloop.component.setting import About
from glucoloop.sensors.delay import LONGEST_LAG_MIN
from glucoloop.unit_guess import ANY_SETTING, CARB_RATIO, CORRECTION, FITTED_STEP, LAG

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
CarbRatio = Annotated[
    float,
    About(
        "Carbohydrate that 1 U covers, in g; 0: of the person's profile, or 500 over the total daily dose.",
        at_least=0.0,
        quantity=CARB_RATIO,
    ),
]
MealShare = Annotated[
    float, About("Share of the bolus for an announced meal that is given; 0: none.", at_least=0.0, at_most=2.0)
]
CorrectionFactor = Annotated[
    float,
    About(
        "Fall of glucose by 1 U, in mg/dl; 0: of the person's profile, or 1800 over the total daily dose.",
        at_least=0.0,
        quantity=CORRECTION,
    ),
]


class ControllerPart(Part):
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
    individual: ClassVar[str | None] = "glucoloop.build.individual:one_by_one"
    """Place ``module:function`` of the design for each person of a trial, see
    `build.individual.individual_design`; None for a controller that is the same for all people."""
    tunable: ClassVar[bool] = False
    """Whether `glucoloop tune` tries a grid of it: it has the settings of a predictive controller, and `horizons` and
    `padded` as `control.LinearMPC` has them."""
    reference_filters: ClassVar[str | None] = None
    """Range of the setting ``reference_filter`` that `glucoloop tune` tries unless another one is given, like
    ``.3:.8:.05``; without it, the usual value alone."""
    gives_boluses: ClassVar[bool] = False
    """Whether it decides on boluses too; the controller then has ``gives_boluses = True`` as well."""
    used: ClassVar[frozenset[Need]] = frozenset({READINGS, ANNOUNCEMENTS, AHEAD, TIME_OF_DAY, PROFILE, CHANCE})
    """Needs that it meets, by what it uses; one that does not say it is taken to use everything."""
    slow: ClassVar[bool] = False
    """Whether it takes long to compile, up to a minute, and some twenty times as long as linear MPC to decide, so that
    studies of many loops use fewer and shorter ones with it."""
    searched: ClassVar[tuple[Tuned, ...]] = ()
    """Settings that `glucoloop robust` can search, with their usual ranges."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        for place in filter(None, (cls.individual,)):
            if not all(place.partition(":")):
                raise TypeError(f"{place!r} of the controller {cls.name} is no place; write it like module:function")
        if cls.tunable and not hasattr(cls, "move_horizon"):
            raise TypeError(f"the controller {cls.name} cannot be tunable: it lacks one of {', '.join(_TUNED)}")

    def __post_init__(self) -> None:
        for name, setting in self.settings().items():
            if setting.is_part:
                object.__setattr__(self, name, getattr(self, name).completed())

    @classmethod
    def usual_of_route(cls, insulin_route: str) -> Mapping[str, Any]:
        """Usual settings for a route of insulin, where they differ from the defaults, for readings without noise."""
        return {name: usual.noise_free for name, usual in ROUTES[insulin_route].tunings.get(cls.name, {}).items()}

    def uses(self) -> frozenset[Need]:
        """Needs that a controller with these settings meets; boluses and a design for each person are two of them."""
        boluses = frozenset({BOLUSES}) if self.gives_boluses else frozenset()
        return self.used | boluses | (frozenset() if self.individual is None else frozenset({INDIVIDUAL}))

    def designed(self, case: Any) -> Any:
        """The controller for a `control.design_case.DesignCase`, or a Refusal; designing imports JAX."""
        raise NotImplementedError


class ByProfile(ControllerPart):
    """Declaration of a controller that doses by the profile of a person and gives boluses."""

    uses_model: ClassVar = False
    individual: ClassVar = "glucoloop.build.individual:by_profile"
    gives_boluses: ClassVar = True
    used: ClassVar = DOSES_BY_PROFILE
