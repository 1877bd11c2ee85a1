"""Scenario of a run: the meals, their times, the horizon and the setpoint."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax.numpy as jnp
import numpy as np

from glucoloop._representation import represented
from glucoloop.arguments import ArgumentTypeError, checked, is_traced
from glucoloop.meals.absorption import Absorption, absorb
from glucoloop.meals.models import MEAL_MODELS, check_meal_model, meal_model, meal_model_of
from glucoloop.meals.protocol import SHORTEST_EATING_MIN, Eaten, MealModel
from glucoloop.meals.rescue import RescueCarbs
from glucoloop.physiology.exercise import Exercise, exercise_in_order
from glucoloop.physiology.rhythm import Rhythm
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import GLUCOSE, SETPOINT, refuse_unusual
from glucoloop.units import LARGEST_MEAL_G, LONGEST_AHEAD_MIN, LONGEST_RUN_MIN, MIN_PER_DAY

LONGEST_EATING_MIN: Final = MIN_PER_DAY


@checked
@dataclass(frozen=True)
class Meal:
    """Carbohydrate eaten at one moment, or from then on at a constant rate.

    Parameters
    ----------
    t_min : float
        Time at which eating begins; before 0 within the warm-up of a scenario.
    eating_min : float
        Duration of eating; 0 for a meal that is eaten at once.
    announced_g : float, optional
        Carbohydrate that is announced to the controller, if the scenario announces meals; the true one by default.
    announced_min : float, optional
        Time at which it is announced, before or after eating begins; by default when eating begins, or as long before
        as the scenario says.

    Raises
    ------
    ValueError
        Unless ``0 < carbs_g <= 1000``, the times are finite, ``eating_min`` is 0 or from 1 to 1440, and
        ``announced_g`` is from 0 to 1000.
    """

    carbs_g: float
    t_min: float
    eating_min: float = 0.0
    announced_g: float | None = None
    announced_min: float | None = None

    def __post_init__(self) -> None:
        if not is_traced(self.carbs_g) and not 0.0 < self.carbs_g <= LARGEST_MEAL_G:  # false for NaN too
            raise Refusal(
                f"a meal of {self.carbs_g:g} g is not possible; give more than 0 and at most {LARGEST_MEAL_G:g} g"
            )
        for time in (self.t_min, self.announced_min):
            if time is not None and not is_traced(time) and not math.isfinite(time):
                what = "a meal" if time is self.t_min else "a meal that is announced"
                raise Refusal(f"{what} at {time:g} min is not possible; give a finite time")
        announced = self.announced_g
        if announced is not None and not is_traced(announced) and not 0.0 <= announced <= LARGEST_MEAL_G:
            raise Refusal(
                f"a meal that is announced as {announced:g} g is not possible; "
                f"give 0 to {LARGEST_MEAL_G:g} g, or leave it out"
            )
        if is_traced(self.eating_min) or self.eating_min == 0.0:
            return
        if not SHORTEST_EATING_MIN <= self.eating_min <= LONGEST_EATING_MIN:
            raise Refusal(
                f"a meal eaten over {self.eating_min:g} min is not possible; give 0 for a meal that is eaten at once, "
                f"or {SHORTEST_EATING_MIN:g} to {LONGEST_EATING_MIN:g} min"
            )


@represented
@checked
@dataclass(frozen=True)
class Scenario:
    """Meals, a horizon, and the setpoint of glucose.

    Parameters
    ----------
    horizon_min : float
        Length of the run without its warm-up; a whole number of samples.
    setpoint_mg_dl : float, optional
        Target of the controller; the patient's own by default.
    initial_glucose_mg_dl : float, optional
        The patient starts at steady state at this value; by default at the patient's setpoint.
    announced : bool
        Whether the controller is told of each meal when it begins.
    announced_before_min : float
        Time before eating at which meals are announced. Controllers are told that a meal is eaten so many minutes after
        its announcement, also of one whose own `announced_min` is another. An announcement that would come before the
        start is heard at the start.
    meal_model : MealModel or str, optional
        Model of absorption, or its name; the patient's own meal model by default.
    allow_unusual : bool
        Whether an implausible glucose, such as 5.5 mg/dl, is accepted.
    start_min : float, optional
        Time of day at the start, in minutes after midnight, of which the controller is told; by default it is not.
    exercise : iterable of Exercise
        Bouts of exercise, of which the controller is not told; for a patient that takes exercise.
    rhythms : iterable of Rhythm
        Rhythms of the patient by the clock, which starts at midnight unless `start_min` says otherwise. The patient
        rests, and controllers are designed, as without them.
    rhythm_seed, rhythm_person : int
        Seed and number of the person, of which rhythms make their random numbers.
    rescue : RescueCarbs, optional
        Carbohydrate that the person eats when glucose is low, see `meals.rescue_carbs`; none by default.
    warm_up_min : float
        Time before the start that is simulated, with the meals that begin before 0, and not counted; a whole number of
        samples.

    Raises
    ------
    ValueError
        For a horizon that is not positive or longer than a year, a meal or exercise that begins after it or before the
        warm-up, a glucose that is not positive or that is implausible, a meal model that is unknown or not possible, a
        time of day that is none, or a warm-up below 0 or too long.
    """

    meals: tuple[Meal, ...] = (Meal(50.0, 50.0),)
    horizon_min: float = 600.0
    setpoint_mg_dl: float | None = None
    initial_glucose_mg_dl: float | None = None
    announced: bool = False
    announced_before_min: float = 0.0
    allow_unusual: bool = False
    meal_model: MealModel | None = None
    start_min: float | None = None
    exercise: tuple[Exercise, ...] = ()
    rhythms: tuple[Rhythm, ...] = ()
    rhythm_seed: int = 0
    rhythm_person: int = 0
    warm_up_min: float = 0.0
    rescue: RescueCarbs | None = None

    def __init__(
        self,
        meals: Iterable[Meal] = (Meal(50.0, 50.0),),
        horizon_min: float = 600.0,
        *,
        setpoint_mg_dl: float | None = None,
        initial_glucose_mg_dl: float | None = None,
        announced: bool = False,
        announced_before_min: float = 0.0,
        allow_unusual: bool = False,
        meal_model: MealModel | str | None = None,
        start_min: float | None = None,
        exercise: Iterable[Exercise] = (),
        rhythms: Iterable[Rhythm] = (),
        rhythm_seed: int = 0,
        rhythm_person: int = 0,
        warm_up_min: float = 0.0,
        rescue: RescueCarbs | None = None,
    ) -> None:
        object.__setattr__(self, "meals", in_order(meals))
        object.__setattr__(self, "horizon_min", horizon_min)
        object.__setattr__(self, "setpoint_mg_dl", setpoint_mg_dl)
        object.__setattr__(self, "initial_glucose_mg_dl", initial_glucose_mg_dl)
        object.__setattr__(self, "announced", announced)
        object.__setattr__(self, "announced_before_min", announced_before_min)
        object.__setattr__(self, "allow_unusual", allow_unusual)
        object.__setattr__(self, "meal_model", _meal_model(meal_model))
        object.__setattr__(self, "start_min", start_min)
        object.__setattr__(self, "exercise", tuple(exercise))
        object.__setattr__(self, "rhythms", tuple(rhythms))
        object.__setattr__(self, "rhythm_seed", rhythm_seed)
        object.__setattr__(self, "rhythm_person", rhythm_person)
        object.__setattr__(self, "warm_up_min", warm_up_min)
        object.__setattr__(self, "rescue", rescue)
        if is_traced(horizon_min):
            raise ArgumentTypeError(
                "horizon_min is traced by JAX, but it decides how many samples there are; give a plain number"
            )
        if not 0.0 < self.horizon_min <= LONGEST_RUN_MIN:
            raise Refusal(
                f"a horizon of {self.horizon_min:g} min is not possible; "
                f"give more than 0 and at most {LONGEST_RUN_MIN:g} min"
            )
        if start_min is not None and not is_traced(start_min):
            check_time_of_day(start_min)
        check_warm_up(warm_up_min, horizon_min)
        if not 0.0 <= announced_before_min <= LONGEST_AHEAD_MIN:
            raise Refusal(
                f"meals that are announced {announced_before_min:g} min before eating are not possible; "
                f"give 0 to {LONGEST_AHEAD_MIN:g} min"
            )
        for meal in self.meals:
            if is_traced(meal.t_min):
                continue
            if meal.t_min < -warm_up_min:
                raise Refusal(
                    f"a meal at {meal.t_min:g} min is not possible; give a finite time of {-warm_up_min or 0.0:g} min "
                    "or later"
                )
            if meal.t_min >= self.horizon_min:
                raise Refusal(
                    f"the meal at {meal.t_min:g} min begins after the run ends at {self.horizon_min:g} min; "
                    "move the meal or lengthen the run"
                )
        object.__setattr__(self, "exercise", exercise_in_order(self.exercise, self.horizon_min))
        for called, name, value, quantity in (
            ("a setpoint", "setpoint_mg_dl", setpoint_mg_dl, SETPOINT),
            ("an initial glucose", "initial_glucose_mg_dl", initial_glucose_mg_dl, GLUCOSE),
        ):
            if value is None or is_traced(value):
                continue
            if not 0.0 < value < math.inf:
                raise Refusal(f"{called} of {value:g} mg/dl is not possible; give a finite value above 0 mg/dl")
            if not allow_unusual:
                refuse_unusual(value, quantity, name)

    def eaten(self) -> Eaten:
        """All meals as arrays ``(meals,)``; times count from the beginning of the warm-up."""
        meals = eaten(self.meals)
        return dataclasses.replace(meals, t_min=self.warm_up_min + meals.t_min) if self.warm_up_min else meals

    @property
    def announced_in_min(self) -> float | None:
        """Time to eating that an announcement tells; None where meals are announced when they begin, or not."""
        return self.announced_before_min if self.announced and self.announced_before_min else None

    def absorbed_by(self, patient: object) -> Absorption:
        """All meals as a patient absorbs them: by the scenario's meal model, or else by the patient's own."""
        return absorb(meal_model_of(patient, self.meal_model), self.eaten())


def check_warm_up(warm_up_min: float, horizon_min: float) -> None:
    """Refuse a warm-up that is below 0, or with which a run takes too long."""
    if not 0.0 <= warm_up_min <= LONGEST_RUN_MIN - horizon_min:
        raise Refusal(
            f"a warm-up of {warm_up_min:g} min before {horizon_min:g} min is not possible; give 0 or more, together at "
            f"most {LONGEST_RUN_MIN:g} min"
        )


def check_time_of_day(start_min: float) -> None:
    """Refuse a number that is not a time of day, from 0 to below 1440 min."""
    if not 0.0 <= start_min < MIN_PER_DAY:
        raise Refusal(
            f"a time of day of {start_min:g} min after midnight is not possible; give 0 to below {MIN_PER_DAY:g} min"
        )


def announced_g(meals: Sequence[Meal]) -> Any:
    """Announced carbohydrate of meals, ``(meals,)``."""
    return _row([meal.carbs_g if meal.announced_g is None else meal.announced_g for meal in meals])


def announced_min(meals: Sequence[Meal], before_min: float = 0.0) -> Any:
    """Times at which meals are announced, ``(meals,)``: so long before eating unless a meal says otherwise."""
    return _row([meal.t_min - before_min if meal.announced_min is None else meal.announced_min for meal in meals])


def _row(values: Sequence[Any]) -> Any:
    return jnp.asarray(values, float) if is_traced(values) else np.array(values, float)


def _meal_model(given: MealModel | str | None) -> MealModel | None:
    if given is None:
        return None
    model = meal_model(given) if isinstance(given, str) else given
    if not isinstance(model, MealModel):
        known = ", ".join(MEAL_MODELS)
        raise ArgumentTypeError(f"meal_model is {model!r}, which is no meal model; give one, or a name: {known}")
    check_meal_model(model)
    return model


def eaten(meals: Sequence[Meal]) -> Eaten:
    """Meals as arrays ``(meals,)``."""
    return Eaten(**{name: _row([getattr(meal, name) for meal in meals]) for name in Eaten.__annotations__})


def in_order(meals: Iterable[Meal]) -> tuple[Meal, ...]:
    """Meals sorted by time, or in the given order if a time is not known yet; what is no meal is refused."""
    given = tuple(meals)
    for meal in given:
        if not isinstance(meal, Meal):
            raise ArgumentTypeError(f"meals holds {meal!r}, which is no meal; give meals such as Meal(50.0, 60.0)")
    if is_traced([meal.t_min for meal in given]):
        return given
    return tuple(sorted(given, key=lambda meal: meal.t_min))
