"""Controllers: pure functions from observations to doses, designed once and never handed a patient."""

from glucoloop.control.guard import Guard, guarded
from glucoloop.control.guard_settings import GuardSettings
from glucoloop.control.imc import IMC, design_imc
from glucoloop.control.linear_mpc import LinearMPC, design_linear_mpc
from glucoloop.control.meal_mpc import MealMPC, MealTuning, design_meal_mpc
from glucoloop.control.mpc_se import MPCSE, design_mpc_se
from glucoloop.control.nlqdmc_se import NLQDMC, design_nlqdmc_se
from glucoloop.control.open_loop import OpenLoop, design_open_loop
from glucoloop.control.pid import PID, PIDTuning, design_pid, internal_model_tuning
from glucoloop.control.protocol import Controller, Decision, Observation, Status
from glucoloop.control.tuning import MPCTuning, StateTuning

__all__ = [
    "IMC",
    "MPCSE",
    "NLQDMC",
    "PID",
    "Controller",
    "Decision",
    "Guard",
    "GuardSettings",
    "LinearMPC",
    "MPCTuning",
    "MealMPC",
    "MealTuning",
    "Observation",
    "OpenLoop",
    "PIDTuning",
    "StateTuning",
    "Status",
    "design_imc",
    "design_linear_mpc",
    "design_meal_mpc",
    "design_mpc_se",
    "design_nlqdmc_se",
    "design_open_loop",
    "design_pid",
    "guarded",
    "internal_model_tuning",
]
