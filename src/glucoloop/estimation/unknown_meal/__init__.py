"""Estimation of meals that are not announced, from glucose and insulin alone."""

from glucoloop.estimation.unknown_meal.habits import MealHabits
from glucoloop.estimation.unknown_meal.kalman import MealKalman, design_meal_kalman
from glucoloop.estimation.unknown_meal.moving_horizon import MealHorizon, design_meal_horizon
from glucoloop.estimation.unknown_meal.protocol import MealEstimate, MealEstimator, Sensed
from glucoloop.estimation.unknown_meal.replay import MealEstimates, estimate_meals

__all__ = [
    "MealEstimate",
    "MealEstimates",
    "MealEstimator",
    "MealHabits",
    "MealHorizon",
    "MealKalman",
    "Sensed",
    "design_meal_horizon",
    "design_meal_kalman",
    "estimate_meals",
]
