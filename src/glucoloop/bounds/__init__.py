"""Bounds: the best that any controller could do for a patient, given the meals, the pump and the sensor noise."""

from glucoloop.bounds.hedging import HedgedDoses, hedged_doses
from glucoloop.bounds.least_risk import LeastRiskDoses, least_risk_doses
from glucoloop.bounds.optimal_doses import (
    IN_ADVANCE,
    OBJECTIVES,
    Distance,
    OptimalDoses,
    bound_of_situation,
    distance_to_bound,
    optimal_doses,
)

__all__ = [
    "IN_ADVANCE",
    "OBJECTIVES",
    "Distance",
    "HedgedDoses",
    "LeastRiskDoses",
    "OptimalDoses",
    "bound_of_situation",
    "distance_to_bound",
    "hedged_doses",
    "least_risk_doses",
    "optimal_doses",
]
