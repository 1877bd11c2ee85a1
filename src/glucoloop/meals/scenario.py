"""A scenario: what is eaten, when, and for how long the loop runs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from glucoloop.meals.lehmann_deutsch import Emptying, emptying

LARGEST_MEAL_G: Final = 1000.0
LONGEST_HORIZON_MIN: Final = 366 * 1440.0


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
        if not 0.0 < self.carbs_g <= LARGEST_MEAL_G:  # false for NaN too
            raise ValueError(
                f"a meal of {self.carbs_g:g} g is not possible; give more than 0 and at most {LARGEST_MEAL_G:g} g"
            )
        if not 0.0 <= self.t_min < math.inf:
            raise ValueError(f"a meal at {self.t_min:g} min is not possible; give a finite time of 0 min or later")


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

    Raises
    ------
    ValueError
        For a horizon that is not positive or longer than a year, a meal that begins after it, or a glucose that is not
        positive.
    """

    meals: tuple[Meal, ...] = (Meal(50.0, 50.0),)
    horizon_min: float = 600.0
    setpoint_mg_dl: float | None = None
    initial_glucose_mg_dl: float | None = None
    announced: bool = False

    def __init__(
        self,
        meals: Iterable[Meal] = (Meal(50.0, 50.0),),
        horizon_min: float = 600.0,
        *,
        setpoint_mg_dl: float | None = None,
        initial_glucose_mg_dl: float | None = None,
        announced: bool = False,
    ) -> None:
        object.__setattr__(self, "meals", tuple(sorted(meals, key=lambda meal: meal.t_min)))
        object.__setattr__(self, "horizon_min", float(horizon_min))
        object.__setattr__(self, "setpoint_mg_dl", setpoint_mg_dl)
        object.__setattr__(self, "initial_glucose_mg_dl", initial_glucose_mg_dl)
        object.__setattr__(self, "announced", announced)
        if not 0.0 < self.horizon_min <= LONGEST_HORIZON_MIN:
            raise ValueError(
                f"a horizon of {self.horizon_min:g} min is not possible; "
                f"give more than 0 and at most {LONGEST_HORIZON_MIN:g} min"
            )
        for meal in self.meals:
            if meal.t_min >= self.horizon_min:
                raise ValueError(
                    f"the meal at {meal.t_min:g} min begins after the run ends at {self.horizon_min:g} min; "
                    "move the meal or lengthen the run"
                )
        for name, value in (("setpoint", setpoint_mg_dl), ("initial glucose", initial_glucose_mg_dl)):
            if value is not None and not 0.0 < value < math.inf:
                raise ValueError(f"a {name} of {value:g} mg/dl is not possible; give a finite value above 0 mg/dl")

    def emptying(self) -> Emptying:
        """Gastric emptying of all meals."""
        kinks: Emptying = emptying(
            np.array([meal.t_min for meal in self.meals], float), np.array([meal.carbs_g for meal in self.meals], float)
        )
        return kinks
