"""A run: one controller or several in a situation, with the meals of one person."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Annotated, ClassVar, Final, Literal

from glucoloop.control.guard_settings import GuardSettings
from glucoloop.limits import LONGEST_RUN_MIN
from glucoloop.models.settings import ModelPart
from glucoloop.parts.grammar import Tree
from glucoloop.plausible import DURATION, GLUCOSE
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case
from glucoloop.situations.option import CONTROLLER_PANEL, PATIENT_PANEL, Option
from glucoloop.situations.situation import LONGEST_SAMPLE_TIME_MIN, Situation

if TYPE_CHECKING:
    from glucoloop.meals import Meal, Scenario

BOLUS_INTO_A_VEIN: Final = (
    "This patient gets insulin into a vein, where a bolus acts for minutes and a meal lasts for hours; boluses are "
    "meant for insulin under the skin, as of hovorka-2004."
)
_MOST_CASES: Final = 20
_controller = functools.partial(Option, panel=CONTROLLER_PANEL)


class ControlledSituation(Situation):
    """A situation with the controllers that act in it."""

    kind: ClassVar = "situation"

    controller: Annotated[
        tuple[Case, ...],
        _controller(
            "Controller with its settings, like 'mpc-se, move_horizon=2, label=careful'; repeat it for more. Without "
            "a name the settings are those of the controller that is there.",
            default="mpc",
        ),
    ] = ()
    guard: Annotated[
        GuardSettings | None,
        _controller(
            "Put a guard around the controllers: it rejects impossible readings, gives the basal rate without "
            "readings, suspends insulin on predicted low glucose, and bounds the dose.",
            alone="usual",
        ),
    ] = None
    model: Annotated[
        ModelPart | None,
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
        if len(labels) > _MOST_CASES and type(self).few_cases:
            raise Refusal(f"{len(labels)} controllers at once are too many; give at most {_MOST_CASES}")
        if self.model is not None and not any(case.model is not None for case in self.cases):
            used = ", ".join(dict.fromkeys(case.controller.called for case in self.cases))
            raise Refusal(f"a model is given, but none of these controllers uses one: {used}; leave it out")

    few_cases: ClassVar[bool] = True

    @functools.cached_property
    def cases(self) -> tuple[Case, ...]:
        """The controllers with everything that is usual in the situation; a refusal has the label of the case."""
        found = []
        for case in self.controller or (Case.partial({}),):
            try:
                found.append(case.completed_in(self, self.guard, self.model))
            except Refusal as error:
                message = str(error)
                raise Refusal(message if len(self.controller) < 2 else f"case {case.label!r}: {message}") from None
        return tuple(found)

    @property
    def case(self) -> Case:
        """The only controller; Refusal if there are several."""
        if len(self.cases) > 1:
            raise Refusal(
                f"there are {len(self.cases)} controllers ({', '.join(case.label for case in self.cases)}); give one, "
                "or use glucoloop compare or glucoloop trial"
            )
        return self.cases[0]

    def tree(self, *, whole: bool = False) -> Tree:
        """Given settings as plain values; with `whole` all that are used, guard and model in each case."""
        found = super().tree(whole=whole)
        if whole:
            if "controller" in found:
                found["controller"] = [case.tree(whole=True) for case in self.cases]
            for key in ("guard", "model"):
                found.pop(key, None)
        return found

    def refuse_unusual(self) -> None:
        """Refuse what is possible and implausible where it is put together."""
        self.refuse_unusual_pump()


class Run(ControlledSituation):
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
        Option(
            "Carbohydrate and time, like 50g@50min or 50g@1.5h, or 50g@1.5h/15min if eating takes 15 min; repeat it "
            "for more; none for no meal.",
            panel=PATIENT_PANEL,
            flag="--meal",
            metavar="G@TIME",
        ),
    ] = ("50g@50min",)
    duration_min: Annotated[
        float, Option("Length of the run.", above=0.0, at_most=LONGEST_RUN_MIN, quantity=DURATION)
    ] = 600.0
    integrator: Annotated[
        Literal["fast", "adaptive"],
        Option("fast: one exponential step per sample; adaptive: Runge-Kutta of order 8, the reference.", rare=True),
    ] = "fast"

    def __post_init__(self) -> None:
        from glucoloop.situations.meal_text import same_meals

        super().__post_init__()
        object.__setattr__(self, "meals", same_meals(self.meals))
        refuse_parts_of_samples(self.duration_min, self.sample_time_min)
        self.refuse_late_faults(self.duration_min)

    def eaten(self) -> tuple[Meal, ...]:
        """Meals of the run, with the announced carbohydrate of each where it is counted with an error."""
        from glucoloop.meals.plan import counted_meals
        from glucoloop.situations.meal_text import parse_meal

        meals = tuple(parse_meal(text) for text in self.meals)
        if not self.miscounts:
            return meals
        return counted_meals(meals, self.seed, error_pct=self.carb_error_pct, bias_pct=self.carb_bias_pct)

    def scenario(self) -> Scenario:
        """Meals, length, target, start and time of day; Refusal for meals or a length that are not possible."""
        from glucoloop.meals import Scenario

        return Scenario(
            self.eaten(),
            self.duration_min,
            setpoint_mg_dl=self.setpoint_mg_dl,
            initial_glucose_mg_dl=self.initial_glucose_mg_dl,
            allow_unusual=self.allow_unusual,
            announced=self.announce_meals,
            meal_model=self.gut,
            start_min=self.start_min,
        )

    def refuse_unusual(self) -> None:
        """Refuse what is possible and implausible, meals too."""
        from glucoloop.situations.meal_text import refuse_unusual_meals

        super().refuse_unusual()
        refuse_unusual_meals(self.given.get("meals", ()), self.duration_min)


def refuse_parts_of_samples(horizon_min: float, sample_time_min: float, *, has_duration: bool = True) -> None:
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
    mends = [f"--sample-time {min(possible, key=lambda minutes: abs(minutes - sample_time_min)):g}"] if possible else []
    if has_duration:
        mends.append(f"--duration {max(1, round(horizon_min / sample_time_min)) * sample_time_min:g}")
    raise Refusal(
        f"a horizon of {horizon_min:g} min is not a whole number of samples of {sample_time_min:g} min; "
        f"give {' or '.join(mends) or 'another sample time'}"
    )


def boluses_into_a_vein(asked: ControlledSituation) -> tuple[str, ...]:
    """`BOLUS_INTO_A_VEIN` if any of the controllers gives boluses to a patient with insulin into a vein."""
    boluses = any(case.controller.gives_boluses for case in asked.cases)
    return (BOLUS_INTO_A_VEIN,) if boluses and not asked.patient.under_the_skin else ()
