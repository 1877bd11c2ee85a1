"""Meals: eating, gastric emptying and absorption."""

from glucoloop.meals.absorption import Absorption, absorb, fasting
from glucoloop.meals.dalla_man import DallaManGut
from glucoloop.meals.hovorka import HovorkaGut
from glucoloop.meals.ingestion import Ingestion
from glucoloop.meals.lehmann_deutsch import LehmannDeutsch
from glucoloop.meals.linear import LinearAbsorption, appearance_mg_min, appearance_moments, emptying_mg_min
from glucoloop.meals.models import meal_model, meal_model_of
from glucoloop.meals.plan import MealPlan, draw_meals
from glucoloop.meals.protocol import Eaten, Jumps, LinearMealModel, MealModel, OdeMealModel
from glucoloop.meals.scenario import Meal, Scenario, eaten

__all__ = [
    "Absorption",
    "DallaManGut",
    "Eaten",
    "HovorkaGut",
    "Ingestion",
    "Jumps",
    "LehmannDeutsch",
    "LinearAbsorption",
    "LinearMealModel",
    "Meal",
    "MealModel",
    "MealPlan",
    "OdeMealModel",
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
