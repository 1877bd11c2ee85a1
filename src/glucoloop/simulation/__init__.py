"""Carrying patients through time: integrators, the closed loop, and the experiments made with it."""

from glucoloop.simulation.adaptive import Adaptive
from glucoloop.simulation.closed_loop import Trace, simulate
from glucoloop.simulation.experiment import excite, identify, validate_on
from glucoloop.simulation.exponential import Exponential

__all__ = ["Adaptive", "Exponential", "Trace", "excite", "identify", "simulate", "validate_on"]
