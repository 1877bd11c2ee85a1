"""Test of estimators of unknown meals: delay, certainty and accuracy on days of people under a controller."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from glucoloop.component.effects import READINGS, TIME_OF_DAY, Need
from glucoloop.component.request import Request, by_default, completed, request_of
from glucoloop.component.setting import PATIENT_PANEL, Option
from glucoloop.control.catalogue import CONTROLLERS, ESTIMATING
from glucoloop.control.part import ControllerComponent
from glucoloop.estimation.unknown_meal import ESTIMATORS, EstimatorComponent
from glucoloop.refusal import Refusal
from glucoloop.sensors import SensorComponent, WhiteNoise
from glucoloop.situations.case import Case, cases_of
from glucoloop.studies.study import PlainStudy
from glucoloop.trials.trial import Trial
from glucoloop.units import MAX_DAYS

if TYPE_CHECKING:
    from glucoloop.meals.plan import MealPlan

_DEFAULT_DAYS: Final = 100
"""Default number of days of one person; of several people, one day each."""
_MAX_RUNS: Final = 100_000
_estimators = functools.partial(Option, panel="Estimators")


class Detection(Trial):
    """Estimators, and the days on which they are tried.

    Each day of each person begins at steady state at midnight and has meals and noise of its own. As many days again
    are without a meal.
    """

    kind: ClassVar = "test of estimators"
    # an estimator need not find announced meals
    refused: ClassVar[tuple[str, ...]] = (
        *(
            "announce_meals",
            "announce_before_min",
            "carb_error_pct",
            "carb_bias_pct",
            "metrics",
            "duration_min",
            "design",
            "traces",
        ),
        *("precision", "arithmetic", "shard_people", "guard", "model"),
        *("rhythm", "exercise", "exercise_spread_pct", "exercise_time_spread_min"),
        *("warm_up_min", "habits", "scenario", "rescue", "glucagon", "events", "actions"),
    )

    # two meals a day of 11 to 99 g, so far apart that one is over when the next begins
    population: Any = "nominal"
    people: int = 1
    meals: tuple[str, ...] = ("55g@5h", "55g@14.5h")
    meal_size_spread_pct: float = 80.0
    meal_time_spread_min: float = 90.0
    sensor: tuple[SensorComponent, ...] = (by_default(WhiteNoise, variance=1.45),)
    controller: tuple[Request[Case], ...] = cases_of(ESTIMATING)
    days: Annotated[
        int | None,
        Option(
            "Days of each person.",
            panel=PATIENT_PANEL,
            default=f"{_DEFAULT_DAYS}; of several people 1",
            at_least=1,
            at_most=MAX_DAYS,
        ),
    ] = None
    estimators: Annotated[
        tuple[EstimatorComponent, ...],
        _estimators("Estimator with its settings, like 'moving-horizon, fast_meals=0'; repeat it.", flag="--estimator"),
    ] = tuple(map(by_default, ESTIMATORS.values()))
    threshold: Annotated[
        float,
        _estimators("Probability of a meal above which it counts as detected.", metavar="P", above=0.0, below=1.0),
    ] = 0.5
    estimates_by: Annotated[
        Request[ControllerComponent] | None,
        _estimators(
            f"Settings of the estimators where the controller has none, like '{ESTIMATING}, meals_per_h=0.1'.",
            default="those of the controller, or the default ones",
        ),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.estimators:
            raise Refusal(f"--estimator names none; give one or more of {', '.join(ESTIMATORS)}")
        if len(self.tried) < len(self.estimators):
            raise Refusal(f"--estimator is {'; '.join(self.tried)}, one of them twice; leave one out")
        if "estimator" in {**self.case.controller.explicit, **getattr(self.estimates_by, "explicit", {})}:
            raise Refusal(
                f"the controller {ESTIMATING} is tried with each of the estimators; leave its "
                "estimator out, and name them by --estimator"
            )
        if self.estimates_by is not None and self.estimates_by.component.name != ESTIMATING:
            raise Refusal(f"--estimates-by is {self.estimates_by.display_name}; give settings of {ESTIMATING}")
        if self.people * self.number_of_days > _MAX_RUNS:
            raise Refusal(
                f"{self.number_of_days} days of {self.people} people are too many; give at most {_MAX_RUNS} days in all"
            )
        _ = self.estimating  # refuses settings that are at odds

    @functools.cached_property
    def tried(self) -> dict[str, EstimatorComponent]:
        """The estimators by their texts."""
        return {part.request.text: part for part in self.estimators}

    def uses(self) -> frozenset[Need]:
        """Needs that the trial meets, where estimators see readings and may know the time of day."""
        return super().uses() | {READINGS, TIME_OF_DAY}

    @property
    def number_of_days(self) -> int:
        """Days of each person."""
        return self.days or (_DEFAULT_DAYS if self.people == 1 else 1)

    @functools.cached_property
    def estimating(self) -> ControllerComponent:
        """The controller to which the estimators belong, with all settings."""
        of_case = request_of(self.case.controller)
        default = of_case if of_case.component.name == ESTIMATING else Request(CONTROLLERS[ESTIMATING])
        defaults = self.patient.controller_defaults(ESTIMATING)
        return completed(self.estimates_by or default, defaults, noisy=self.noisy)

    @functools.cached_property
    def trial(self) -> Trial:
        """The trial of one day, with a case for each estimator, by its text, where the controller rests on it."""
        case = self.case
        cases: tuple[Case, ...] = (case,)
        if hasattr(case.controller, "estimator"):
            controller: Any = case.controller
            cases = tuple(
                dataclasses.replace(case, label=label, controller=dataclasses.replace(controller, estimator=part))
                for label, part in self.tried.items()
            )
        return self.with_cases(cases, days=1)

    @property
    def all_days(self) -> MealPlan:
        """Meals of all days of a person."""
        from glucoloop.meals.plan import MealPlan

        day = self.trial.plan
        return MealPlan(
            day.meals,
            self.number_of_days,
            size_spread_pct=day.size_spread_pct,
            time_spread_min=day.time_spread_min,
            own=day.own,
        )


DETECT: Final = PlainStudy(
    name="detect",
    what="a test of estimators",
    help=(
        "Test the estimators of meals that nobody announced: how soon a meal is detected, how exactly its size is "
        "estimated, and how often there is a false alarm.\n\n"
        "Each day begins at steady state and has its own meals and noise; the same number of days is without a meal. "
        "By default 100 days of one person are simulated, with two meals a day of 11 to 99 g, noise of variance 1.45, "
        f"and doses by {ESTIMATING}, which uses the estimator. Others, such as basal, do not use it.\n\n"
        "  glucoloop detect --out detect\n\n"
        "  glucoloop detect --controller basal --estimator moving-horizon --threshold 0.8\n\n"
        "  glucoloop detect --population parker2000 --people 100 --controller meals_per_h=0.1 --out people\n\n"
        "  glucoloop detect --config detect/detect.toml"
    ),
    module="glucoloop.studies.detection.study",
    request=Detection,
    option_texts={
        "help": {
            "controller": "Controller that gives the doses, like 'meal-mpc, meals_per_h=0.1'. Without a name the "
            "settings are those of the controller that is there.",
            "seed": "The same seed gives the same people, meals and noise.",
        }
    },
    summary="detect.json",
)
