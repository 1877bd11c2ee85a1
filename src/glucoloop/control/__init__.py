"""Controllers: pure functions from observations to doses, designed once and never handed a patient."""

from glucoloop.control.linear_mpc import LinearMPC, design_linear_mpc
from glucoloop.control.protocol import Controller, Decision, Observation, Status
from glucoloop.control.tuning import MPCTuning

__all__ = ["Controller", "Decision", "LinearMPC", "MPCTuning", "Observation", "Status", "design_linear_mpc"]
