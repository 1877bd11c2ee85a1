"""A run: one controller or several in a situation, with the meals of one person."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self

from glucoloop.component.effects import (
    CHANCE,
    EXERCISE,
    FORECASTS,
    MEALS,
    MEALS_ANNOUNCED,
    OF_CONTROLLERS,
    READINGS,
    TIME_OF_DAY,
    Need,
)
from glucoloop.component.grammar import Tree
from glucoloop.component.request import Request, completed
from glucoloop.component.setting import CONTROLLER_PANEL, PATIENT_PANEL, Option, value_text
from glucoloop.control.guard_settings import GuardSettings
from glucoloop.models.settings import ModelComponent
from glucoloop.refusal import Refusal
from glucoloop.sensors import whole_samples
from glucoloop.situations.case import Case, completed_case
from glucoloop.situations.scenarios import DEFAULT_DAY, DaySettings, ScenarioComponent
from glucoloop.situations.situation import LONGEST_SAMPLE_TIME_MIN, Situation
from glucoloop.situations.therapy_text import by_clock, changes_option, needs_of, read_change, with_changes
from glucoloop.situations.unused import reason
from glucoloop.therapy import TherapyChange
from glucoloop.unit_guess import GLUCOSE
from glucoloop.units import MIN_PER_DAY

if TYPE_CHECKING:
    import numpy.typing as npt

    from glucoloop.meals import Meal, Scenario
    from glucoloop.meals.habits import LivedDays
    from glucoloop.meals.plan import MealPlan
    from glucoloop.patients.population import Population
    from glucoloop.physiology.exercise import Bouts as DrawnBouts
    from glucoloop.physiology.exercise import Exercise

INTRAVENOUS_BOLUS: Final = (
    "This patient gets intravenous insulin, where a bolus acts for minutes and a meal lasts for hours; boluses are "
    "meant for subcutaneous insulin, as of hovorka-2004."
)
STEADY_WITHOUT_RHYTHM: Final = (
    "The rhythm begins with the run: the patient rests at the start, and controllers are designed, with its clock "
    "stopped, at high sensitivity to insulin and outside of dawn."
)
_MAX_CASES: Final = 20
_controller = functools.partial(Option, panel=CONTROLLER_PANEL)
_meals = functools.partial(Option, panel=PATIENT_PANEL)


class ControlledSituation(Situation):
    """A situation with the controllers that act in it."""

    kind: ClassVar = "situation"

    controller: Annotated[
        tuple[Request[Case], ...],
        _controller(
            "Controller with its settings, like 'mpc-se, move_horizon=2, label=careful'; repeat it for more. Without "
            "a name the settings are those of the controller that is there.",
            default="mpc",
        ),
    ] = ()
    guard: Annotated[
        Request[GuardSettings] | None,
        _controller(
            "Put a guard around the controllers: it rejects impossible readings, gives at most the basal rate "
            "without readings, suspends insulin on predicted low glucose, and bounds the dose.",
            alone="usual",
        ),
    ] = None
    model: Annotated[
        Request[ModelComponent] | None,
        _controller(
            "Model of the controllers: 'memory=48, noise_variance=0', or a file of `glucoloop identify`.",
            default="identified from the patient",
        ),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        labels = [case.label for case in self.cases]
        for label in labels:
            if labels.count(label) > 1:
                raise Refusal(f"two cases are called {label!r}; give each a label of its own, like label=careful")
        if len(labels) > _MAX_CASES and type(self).few_cases:
            raise Refusal(f"{len(labels)} controllers at once are too many; give at most {_MAX_CASES}")
        if self.model is not None and not any(case.model is not None for case in self.cases):
            used = ", ".join(dict.fromkeys(case.controller.display_name for case in self.cases))
            raise Refusal(f"a model is given, but none of these controllers uses one: {used}; leave it out")

    few_cases: ClassVar[bool] = True

    @functools.cached_property
    def cases(self) -> tuple[Case, ...]:
        """The controllers with the defaults of the situation; a refusal has the label of the case."""
        result = []
        for case in self.controller or (Request(Case),):
            try:
                result.append(completed_case(case, self, self.guard, self.model))
            except Refusal as error:
                raise error.within("" if len(self.controller) < 2 else f"case {case.value('label')!r}") from None
        return tuple(result)

    @property
    def case(self) -> Case:
        """The only controller; Refusal if there are several."""
        if len(self.cases) > 1:
            raise Refusal(
                f"there are {len(self.cases)} controllers ({', '.join(case.label for case in self.cases)}); give one, "
                "or use glucoloop compare or glucoloop trial"
            )
        return self.cases[0]

    def uses(self) -> frozenset[Need]:
        """Needs that the situation and its controllers meet: of several, those that any of them does."""
        if "controller" in self.refused:
            return super().uses()
        by_controllers = frozenset[Need]().union(*(part.uses() for part in (*self.cases, *self.actions)))
        by_metrics = frozenset({READINGS} if self.metrics else ())
        return super().uses() - {READINGS} | by_controllers | by_metrics

    def tree(self, *, whole: bool = False) -> Tree:
        """Explicit settings as plain values; with `whole` all that are used, guard and model in each case."""
        result = super().tree(whole=whole)
        if whole:
            if "controller" in result:
                result["controller"] = [case.tree(whole=True) for case in self.cases]
            for key in ("guard", "model"):
                result.pop(key, None)
        return result

    def refuse_unusual(self) -> None:
        """Refuse what is possible and implausible where it is put together."""
        self.refuse_unusual_pump()


class FedSituation(DaySettings, ControlledSituation):
    """A situation with controllers, with the meals of a run or of every day and how long that goes on."""

    kind: ClassVar = "situation"

    scenario: Annotated[
        ScenarioComponent | None,
        _meals(
            "Meals, habits, announcement and length together, like unkind-day, week or 'week, days=14', see glucoloop "
            "list; or a file like days.toml. What is given beside it counts.",
            metavar="NAME|FILE.toml",
            rare=True,
        ),
    ] = None

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The settings with meals and exercise in one way of writing."""
        from glucoloop.situations.meal_text import same_exercise, same_meals

        texts = {"exercise": same_exercise(values["exercise"]), "meals": same_meals(values["meals"])}
        return super().resolved({**values, **texts})

    def __post_init__(self) -> None:
        from glucoloop.physiology.exercise import refuse_exercise

        super().__post_init__()
        if self.exercise:
            refuse_exercise(self.nominal, self.patient.display_name)
        alone = next((habit.display_name for habit in self.habits if habit.of_announcements), None)
        if alone is not None and not self.announce_meals:
            raise Refusal(
                f"the habit {alone} concerns announced meals only",
                "announce the meals (--announce-meals)",
                "leave it out",
            )
        if self.days is not None and self.duration_min is not None:
            raise Refusal("days and duration_min both tell the length; leave one out")
        _refuse_parts_of_samples(self.horizon_min, self.sample_time_min, has_duration=self.days is None)
        whole_samples(self.warm_up_min, self.sample_time_min, "a warm-up")
        self.refuse_late_faults(self.horizon_min)

    @classmethod
    def defaults_of(cls, request: Request[Self], defaults: Mapping[str, Any]) -> Mapping[str, Any]:
        """Defaults, of which a scenario says its own; days or a length that are explicit exclude the other."""
        scenario = request.explicit.get("scenario")
        of_scenario = {} if scenario is None else completed(scenario).values()
        for name in cls.refused:
            if name in of_scenario and of_scenario.pop(name) != Situation.settings()[name].default.noise_free:
                raise Refusal(
                    f"the scenario has {name}, which is no part of a {cls.kind}; leave it out of the scenario"
                )
        defaults = {**defaults, **of_scenario}
        if request.explicit.get("days") is not None:
            defaults["duration_min"] = None
        elif request.explicit.get("duration_min") is not None:
            defaults["days"] = None
        return super().defaults_of(request, defaults)

    def uses(self) -> frozenset[Need]:
        """Needs that the situation meets, with its meals and its exercise where it has them."""
        meals = {MEALS} if self.meals or self.habits or self.rescue is not None else set()
        exercise = {EXERCISE} if self.exercise else set()
        return super().uses() - {MEALS, EXERCISE} | meals | exercise

    @property
    def by_chance(self) -> bool:
        """Whether anything of the situation may be drawn at random, its meals and exercise included."""
        of_meals = self.meal_size_spread_pct or self.meal_time_spread_min or self.habits or self.miscounts
        of_exercise = self.exercise_spread_pct or self.exercise_time_spread_min
        return super().by_chance or bool(of_meals or of_exercise)

    @property
    def horizon_min(self) -> float:
        """Length of the run, without its warm-up."""
        return (self.days or 1) * MIN_PER_DAY if self.duration_min is None else self.duration_min

    @functools.cached_property
    def plan(self) -> MealPlan:
        """Meals, habits and length of the run; Refusal for a meal beyond its day."""
        from glucoloop.meals.plan import MealPlan
        from glucoloop.patients.population import own_meals
        from glucoloop.situations.meal_text import OWN, parse_meal

        plan = functools.partial(
            MealPlan,
            days=self.days or 1,
            size_spread_pct=self.meal_size_spread_pct,
            time_spread_min=self.meal_time_spread_min,
            horizon_min=self.duration_min,
            habits=self.habits,
            warm_up_min=self.warm_up_min,
        )
        if self.meals != (OWN,):
            return plan(map(parse_meal, self.planned_meals))
        people = self.population_with_days()
        assert people.table is not None
        for name, day in zip(people.table.names, people.table.meals, strict=True):
            try:
                plan(day)
            except Refusal as error:
                raise error.within(f"the own day of {name!r}") from None
        return plan(people.table.usual_day(), own=functools.partial(own_meals, people))

    def population_with_days(self) -> Population:
        """People of whom each has a day of meals, which is eaten; Refusal where there are none."""
        raise NotImplementedError

    @functools.cached_property
    def bouts(self) -> tuple[Exercise, ...]:
        """Exercise of all days, without its variation; Refusal for a bout beyond its day."""
        from glucoloop.physiology.exercise import exercise_in_order, repeated_daily
        from glucoloop.situations.meal_text import parse_exercise

        a_day = exercise_in_order(map(parse_exercise, self.exercise), self.plan.day_min)
        return repeated_daily(a_day, self.days or 1)

    def bouts_of(self, person: npt.ArrayLike) -> DrawnBouts | None:
        """Exercise of persons of the seed, with times from the beginning of the warm-up, which has none; or None."""
        from glucoloop.physiology.exercise import draw_bouts

        if not self.exercise:
            return None
        drawn = draw_bouts(
            self.bouts,
            self.seed,
            person,
            intensity_spread_pct=self.exercise_spread_pct,
            time_spread_min=self.exercise_time_spread_min,
            a_day=len(self.exercise),
        )
        return drawn.later(self.warm_up_min)

    @property
    def planned_meals(self) -> tuple[str, ...]:
        """Texts of the meals of the plan."""
        return self.meals

    def drawn_days(self, person: npt.ArrayLike) -> LivedDays:
        """Days of persons of the seed as they are lived, with the counted carbohydrate of each meal."""
        from glucoloop.meals.plan import draw_days

        days = draw_days(self.plan, self.seed, person)
        days = days.counted(self.carb_error_pct, self.carb_bias_pct) if self.miscounts else days
        return days.announced_before(self.announce_before_min) if self.announce_before_min else days

    @property
    def individual_announcements(self) -> bool:
        """Whether what is announced differs between people."""
        return self.miscounts or bool(self.habits) or self.announce_before_min > 0.0

    def scenario_of(
        self, meals: Iterable[Meal], initial_glucose_mg_dl: float | None = None, *, person: int = 0
    ) -> Scenario:
        """Scenario of one person of the seed, by number, with given meals."""
        from glucoloop.meals import Scenario

        return Scenario(
            meals,
            self.horizon_min,
            setpoint_mg_dl=self.setpoint_mg_dl,
            initial_glucose_mg_dl=initial_glucose_mg_dl,
            allow_unusual=self.allow_unusual,
            announced=self.announce_meals,
            announced_before_min=self.announce_before_min,
            meal_model=self.gut,
            start_min=self.start_min,
            warm_up_min=self.warm_up_min,
            exercise=self.exercise_of(person),
            rhythms=self.rhythms,
            rhythm_seed=self.seed,
            rhythm_person=person,
            rescue=self.rescue_carbs,
        )

    def exercise_of(self, person: int) -> tuple[Exercise, ...]:
        """Bouts of one person that begin within the run."""
        drawn = self.bouts_of([person])
        bouts = () if drawn is None else drawn.later(-self.warm_up_min).of(0)
        return tuple(bout for bout in bouts if bout.t_min < self.horizon_min)

    def refuse_unusual(self) -> None:
        """Refuse what is possible and implausible, meals too."""
        from glucoloop.situations.meal_text import refuse_unusual_meals

        super().refuse_unusual()
        refuse_unusual_meals(self.explicit.get("meals", ()), self.horizon_min)


class Run(FedSituation):
    """Controllers in one situation, on one person."""

    kind: ClassVar = "run"

    initial_glucose_mg_dl: Annotated[
        float | None,
        Option(
            "Glucose at which the patient rests at the start; by default the patient's own setpoint.",
            panel=PATIENT_PANEL,
            above=0.0,
            at_most=2000.0,
            quantity=GLUCOSE,
        ),
    ] = None
    meals: Annotated[
        tuple[str, ...],
        _meals(
            "Carbohydrate and time, like 50g@50min or 50g@1.5h, or 50g@1.5h/15min if eating takes 15 min; repeat it "
            "for more; none for no meal, own for the person's own day.",
            flag="--meal",
            metavar="G@TIME",
        ),
    ] = ("50g@50min",)
    duration_min: float | None = 600.0
    integrator: Annotated[
        Literal["fast", "adaptive"],
        Option(
            "fast: exponential steps, or explicit ones of half a minute; adaptive: Runge-Kutta of order 8, the "
            "reference.",
            rare=True,
        ),
    ] = "fast"
    changes: Annotated[tuple[str, ...], changes_option("Change the therapy of the run", PATIENT_PANEL)] = ()
    forecasts: Annotated[
        bool,
        _controller(
            "Keep the forecast and the plan on which each dose rests, in forecasts.csv, and draw some of them.",
            needs=(FORECASTS,),
        ),
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for text in self.changes:
            self._refuse_without_effect(text)
        if self.changes and type(self).changes_together:
            self.with_changes(self.changes)  # refuses what is not possible

    changes_together: ClassVar[bool] = True
    """Whether all changes act together, and not each by itself."""

    @classmethod
    def defaults_of(cls, request: Request[Self], defaults: Mapping[str, Any]) -> Mapping[str, Any]:
        """Defaults, where the meals are those of a day if days are explicit."""
        of_days = {"meals": DEFAULT_DAY} if request.explicit.get("days") is not None else {}
        return super().defaults_of(request, {**of_days, **defaults})

    def uses(self) -> frozenset[Need]:
        """Needs that the run meets, and chance where something is drawn, as a noisy record of a model is."""
        models = any(case.identified.noise_variance for case in self.cases) if "model" not in self.refused else False
        drawn = self.by_chance or models or any(CHANCE in case.uses() for case in self.cases)
        clock = {TIME_OF_DAY} if any(map(by_clock, map(read_change, self.changes))) else set()
        return super().uses() - {CHANCE} | frozenset({CHANCE} if drawn else ()) | clock

    def without_effect(self, text: str, case: Case) -> str:
        """Clause on why a change has no effect under a case; empty where it has one."""
        change, name = read_change(text), case.controller.display_name
        if isinstance(change, TherapyChange) and (own := case.controller.values().get(change.field)):
            return f"the controller {name} has its own {change.field}={value_text(own)}"
        uses = self.uses() - OF_CONTROLLERS | frozenset[Need]().union(*(of.uses() for of in (case, *self.actions)))
        lacking = next((need for need in needs_of(change, case.controller) if need not in uses), None)
        return "" if lacking is None else reason(lacking, [name])

    def _refuse_without_effect(self, text: str) -> None:
        if by_clock(read_change(text)) and self.start is None:
            raise Refusal(
                f"the change {text!r} has hours of the day and needs the time of day at the start",
                "give it, like --start 06:00 (start in a file)",
                "leave the hours out, for all day",
            )
        reasons = [self.without_effect(text, case) for case in self.cases]
        if all(reasons):
            announce = () if self.announce_meals else ("announce the meals (--announce-meals)",)
            raise Refusal(
                f"the change {text!r} has no effect: {'; '.join(dict.fromkeys(reasons))}",
                *(announce if MEALS_ANNOUNCED.reason in reasons else ()),
                "leave it out",
            )

    def with_changes(self, texts: tuple[str, ...]) -> Run:
        """The run under changes of its therapy, each of which acts on what the ones before leave."""
        plain = Run.narrowed(self, changes=())
        try:
            return with_changes(plain, map(read_change, texts)) if texts else plain
        except Refusal as error:
            raise error.within(f"the change {', '.join(map(repr, texts))}") from None

    def population_with_days(self) -> Population:
        """The person, who has a day of meals; Refusal for one who has none."""
        table = None if self.one_person is None else self.one_person.table
        if self.one_person is None or table is None or not table.meals:
            raise Refusal(
                "there is no own day of meals: the patient is no person of a table that has meals",
                "give meals",
                "name such a person, like --patient 'kanderian-2009, person=3'",
            )
        return self.one_person

    def eaten(self) -> tuple[Meal, ...]:
        """Meals of the run, as person 0 of a trial of the seed eats them and counts their carbohydrate."""
        from glucoloop.situations.meal_text import OWN, parse_meal

        varies = self.miscounts or self.habits or self.meal_size_spread_pct or self.meal_time_spread_min
        if not (varies or self.days or self.warm_up_min or self.meals == (OWN,)):
            return tuple(parse_meal(text) for text in self.meals)
        return self.drawn_days([0]).meals_of(0, self.horizon_min)

    def as_scenario(self) -> Scenario:
        """Meals, length, target, start and time of day; Refusal for meals or a length that are not possible."""
        return self.scenario_of(self.eaten(), self.initial_glucose_mg_dl)


def _refuse_parts_of_samples(horizon_min: float, sample_time_min: float, *, has_duration: bool = True) -> None:
    """Refuse a run that is not a whole number of samples long.

    The sentence has the nearest sample time and, where a duration can be given, the nearest that would be possible.
    """

    def fits(minutes: float) -> bool:
        return abs(max(1, round(horizon_min / minutes)) * minutes - horizon_min) <= 1e-9 * horizon_min

    if fits(sample_time_min):
        return
    tenths = (tenth / 10.0 for tenth in range(1, round(10.0 * LONGEST_SAMPLE_TIME_MIN) + 1))
    near = (minutes for minutes in tenths if sample_time_min / 2.0 < minutes < 2.0 * sample_time_min)
    possible = list(filter(fits, near))
    nearest = min(possible, key=lambda minutes: abs(minutes - sample_time_min), default=None)
    mends = [] if nearest is None else [f"give --sample-time {nearest:g}"]
    if has_duration:
        mends.append(f"give --duration {max(1, round(horizon_min / sample_time_min)) * sample_time_min:g}")
    raise Refusal(
        f"a horizon of {horizon_min:g} min is not a whole number of samples of {sample_time_min:g} min",
        *(mends or ["give another sample time"]),
    )


def intravenous_boluses(config: ControlledSituation) -> tuple[str, ...]:
    """`INTRAVENOUS_BOLUS` if a controller, or the person by hand, gives boluses of intravenous insulin."""
    boluses = any(case.controller.gives_boluses for case in config.cases)
    boluses = boluses or any(action.doses for action in config.actions)
    return (INTRAVENOUS_BOLUS,) if boluses and not config.patient.subcutaneous else ()


def steady_without_rhythm(config: Situation) -> tuple[str, ...]:
    """`STEADY_WITHOUT_RHYTHM` if the patient follows a clock."""
    return (STEADY_WITHOUT_RHYTHM,) if config.rhythm else ()
