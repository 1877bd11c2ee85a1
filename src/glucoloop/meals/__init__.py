"""Meals: eating, gastric emptying and absorption."""

from glucoloop.meals.absorption import (
    Absorption,
    absorb,
    appearance_mg_min,
    appearance_moments,
    emptying_mg_min,
    fasting,
)
from glucoloop.meals.hovorka import HovorkaGut
from glucoloop.meals.ingestion import Ingestion
from glucoloop.meals.lehmann_deutsch import LehmannDeutsch
from glucoloop.meals.models import meal_model, meal_model_of
from glucoloop.meals.plan import MealPlan, draw_meals
from glucoloop.meals.protocol import Eaten, Jumps, MealModel
from glucoloop.meals.roy_parker import RoyParkerGut
from glucoloop.meals.scenario import Meal, Scenario, eaten

__all__ = [
    "Absorption",
    "Eaten",
    "HovorkaGut",
    "Ingestion",
    "Jumps",
    "LehmannDeutsch",
    "Meal",
    "MealModel",
    "MealPlan",
    "RoyParkerGut",
    "Scenario",
    "absorb",
    "appearance_mg_min",
    "appearance_moments",
    "draw_meals",
    "eaten",
    "emptying_mg_min",
    "fasting",
    "meal_model",
    "meal_model_of",
]
