"""Bounds: the best that any controller could do for a patient, given the meals, the pump and the sensor noise."""

from glucoloop.bounds.distance import Distance, bound_of_situation, distance_to_bound
from glucoloop.bounds.hedging import HedgedDoses, hedged_doses
from glucoloop.bounds.optimal_doses import IN_ADVANCE, OBJECTIVES, OptimalDoses, optimal_doses

__all__ = [
    "IN_ADVANCE",
    "OBJECTIVES",
    "Distance",
    "HedgedDoses",
    "OptimalDoses",
    "bound_of_situation",
    "distance_to_bound",
    "hedged_doses",
    "optimal_doses",
]
