"""Meals: how they are eaten, emptied and absorbed."""

from glucoloop.meals.lehmann_deutsch import Emptying, appearance_mg_min, appearance_moments, emptying, emptying_mg_min
from glucoloop.meals.plan import MealPlan, draw_meals
from glucoloop.meals.scenario import Meal, Scenario

__all__ = [
    "Emptying",
    "Meal",
    "MealPlan",
    "Scenario",
    "appearance_mg_min",
    "appearance_moments",
    "draw_meals",
    "emptying",
    "emptying_mg_min",
]
