"""Estimation of meals that are not announced, from glucose and insulin alone.

An estimator joins the meal-aware controller and `glucoloop detect` by one class, entered in `ESTIMATORS` or by the
entry point of another package in the group ``glucoloop.estimators``.
"""

from __future__ import annotations

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.estimation.unknown_meal.habits import MealHabits
from glucoloop.estimation.unknown_meal.kalman import KalmanSettings, MealKalman, design_meal_kalman
from glucoloop.estimation.unknown_meal.moving_horizon import MealHorizon, MovingHorizonSettings, design_meal_horizon
from glucoloop.estimation.unknown_meal.protocol import EstimatorComponent, MealEstimate, MealEstimator, Sensed
from glucoloop.estimation.unknown_meal.replay import MealEstimates, estimate_meals

ESTIMATORS: Final = Catalogue(
    EstimatorComponent, (MovingHorizonSettings, KalmanSettings), example="moving-horizon, fast_meals=0", unnamed=True
)

__all__ = [
    "ESTIMATORS",
    "EstimatorComponent",
    "KalmanSettings",
    "MealEstimate",
    "MealEstimates",
    "MealEstimator",
    "MealHabits",
    "MealHorizon",
    "MealKalman",
    "MovingHorizonSettings",
    "Sensed",
    "design_meal_horizon",
    "design_meal_kalman",
    "estimate_meals",
]
