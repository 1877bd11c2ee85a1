"""A scenario: what is eaten, when, and for how long the loop runs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.arguments import ArgumentTypeError, checked, is_traced
from glucoloop.meals.lehmann_deutsch import Emptying, emptying
from glucoloop.plausible import GLUCOSE, SETPOINT, ask

Values = npt.NDArray[np.float64] | jax.Array

LARGEST_MEAL_G: Final = 1000.0
LONGEST_HORIZON_MIN: Final = 366 * 1440.0


@checked
@dataclass(frozen=True)
class Meal:
    """Carbohydrate eaten at one moment.

    Raises
    ------
    ValueError
        Unless ``0 < carbs_g <= 1000`` and ``t_min >= 0``, both finite.
    """

    carbs_g: float
    t_min: float

    def __post_init__(self) -> None:
        if not is_traced(self.carbs_g) and not 0.0 < self.carbs_g <= LARGEST_MEAL_G:  # false for NaN too
            raise ValueError(
                f"a meal of {self.carbs_g:g} g is not possible; give more than 0 and at most {LARGEST_MEAL_G:g} g"
            )
        if not is_traced(self.t_min) and not 0.0 <= self.t_min < math.inf:
            raise ValueError(f"a meal at {self.t_min:g} min is not possible; give a finite time of 0 min or later")


@checked
@dataclass(frozen=True)
class Scenario:
    """Meals, a horizon, and where glucose should be.

    Parameters
    ----------
    meals : iterable of Meal
    horizon_min : float
        Length of the run; a whole number of samples.
    setpoint_mg_dl : float, optional
        Target of the controller; the patient's own by default.
    initial_glucose_mg_dl : float, optional
        The patient starts at rest at this value; at his setpoint by default.
    announced : bool
        Whether the controller is told of each meal when it begins.
    allow_unusual : bool
        Whether a glucose that is hardly meant, such as 5.5 mg/dl, is taken as it is.

    Raises
    ------
    ValueError
        For a horizon that is not positive or longer than a year, a meal that begins after it, a glucose that is not
        positive, or one that is hardly meant.
    """

    meals: tuple[Meal, ...] = (Meal(50.0, 50.0),)
    horizon_min: float = 600.0
    setpoint_mg_dl: float | None = None
    initial_glucose_mg_dl: float | None = None
    announced: bool = False
    allow_unusual: bool = False

    def __init__(
        self,
        meals: Iterable[Meal] = (Meal(50.0, 50.0),),
        horizon_min: float = 600.0,
        *,
        setpoint_mg_dl: float | None = None,
        initial_glucose_mg_dl: float | None = None,
        announced: bool = False,
        allow_unusual: bool = False,
    ) -> None:
        object.__setattr__(self, "meals", in_order(meals))
        object.__setattr__(self, "horizon_min", horizon_min)
        object.__setattr__(self, "setpoint_mg_dl", setpoint_mg_dl)
        object.__setattr__(self, "initial_glucose_mg_dl", initial_glucose_mg_dl)
        object.__setattr__(self, "announced", announced)
        object.__setattr__(self, "allow_unusual", allow_unusual)
        if is_traced(horizon_min):
            raise ArgumentTypeError(
                "horizon_min is traced by JAX, but it decides how many samples there are; give a plain number"
            )
        if not 0.0 < self.horizon_min <= LONGEST_HORIZON_MIN:
            raise ValueError(
                f"a horizon of {self.horizon_min:g} min is not possible; "
                f"give more than 0 and at most {LONGEST_HORIZON_MIN:g} min"
            )
        for meal in self.meals:
            if not is_traced(meal.t_min) and meal.t_min >= self.horizon_min:
                raise ValueError(
                    f"the meal at {meal.t_min:g} min begins after the run ends at {self.horizon_min:g} min; "
                    "move the meal or lengthen the run"
                )
        for called, name, value, quantity in (
            ("a setpoint", "setpoint_mg_dl", setpoint_mg_dl, SETPOINT),
            ("an initial glucose", "initial_glucose_mg_dl", initial_glucose_mg_dl, GLUCOSE),
        ):
            if value is None or is_traced(value):
                continue
            if not 0.0 < value < math.inf:
                raise ValueError(f"{called} of {value:g} mg/dl is not possible; give a finite value above 0 mg/dl")
            if not allow_unusual:
                ask(value, quantity, name)

    def emptying(self) -> Emptying:
        """Gastric emptying of all meals."""
        kinks: Emptying = emptying(self.meal_t_min(), self.carbs_g())
        return kinks

    def meal_t_min(self) -> Values:
        """When each meal begins ``(meals,)``."""
        return _values([meal.t_min for meal in self.meals])

    def carbs_g(self) -> Values:
        """Carbohydrate of each meal ``(meals,)``."""
        return _values([meal.carbs_g for meal in self.meals])


def _values(of_meals: list[float]) -> Values:
    return jnp.asarray(of_meals, float) if is_traced(of_meals) else np.array(of_meals, float)


def in_order(meals: Iterable[Meal]) -> tuple[Meal, ...]:
    """Meals by their times; as they are given where a time is not known yet.

    Raises
    ------
    ArgumentTypeError
        For what is no meal.
    """
    given = tuple(meals)
    for meal in given:
        if not isinstance(meal, Meal):
            raise ArgumentTypeError(f"meals holds {meal!r}, which is no meal; give meals such as Meal(50.0, 60.0)")
    if is_traced([meal.t_min for meal in given]):
        return given
    return tuple(sorted(given, key=lambda meal: meal.t_min))
