"""Meals: how they are eaten, emptied and absorbed."""

from glucoloop.meals.lehmann_deutsch import Emptying, appearance_mg_min, appearance_moments, emptying, emptying_mg_min
from glucoloop.meals.scenario import Meal, Scenario

__all__ = [
    "Emptying",
    "Meal",
    "Scenario",
    "appearance_mg_min",
    "appearance_moments",
    "emptying",
    "emptying_mg_min",
]
