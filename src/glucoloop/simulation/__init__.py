"""Simulation of patients over time: integrators, the closed loop, and experiments with it."""

from glucoloop.simulation.adaptive import Adaptive
from glucoloop.simulation.closed_loop import simulate, usual_limits
from glucoloop.simulation.experiment import excite, fit_step, identify, validate_on
from glucoloop.simulation.explicit import Explicit
from glucoloop.simulation.exponential import Exponential
from glucoloop.simulation.internal_model import linear_model, nonlinear_model
from glucoloop.simulation.stepper import Stepper
from glucoloop.simulation.trace import Trace

__all__ = [
    "Adaptive",
    "Explicit",
    "Exponential",
    "Stepper",
    "Trace",
    "excite",
    "fit_step",
    "identify",
    "linear_model",
    "nonlinear_model",
    "simulate",
    "usual_limits",
    "validate_on",
]
