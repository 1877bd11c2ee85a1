"""Controllers: pure functions from observations to doses, designed once and without access to a patient.

The names below are imported when first used: the settings of the controllers are read without JAX, for help.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from glucoloop.control.basal_bolus import BasalBolus, design_basal_bolus
    from glucoloop.control.guard import Guard, guarded
    from glucoloop.control.imc import IMC, design_imc
    from glucoloop.control.linear_mpc import LinearMPC, design_linear_mpc
    from glucoloop.control.meal_mpc import MealMPC, design_meal_mpc
    from glucoloop.control.mpc_se import MPCSE, design_mpc_se
    from glucoloop.control.nlqdmc_se import NLQDMC, design_nlqdmc_se
    from glucoloop.control.open_loop import OpenLoop, design_open_loop
    from glucoloop.control.pace import Paced, paced
    from glucoloop.control.pid import PID, PIDTuning, design_pid, internal_model_tuning
    from glucoloop.control.protocol import Controller, Decision, Observation, Status
    from glucoloop.control.settings import MealTuning, MPCTuning, StateTuning
    from glucoloop.parts.guard import GuardSettings

__all__ = [
    "IMC",
    "MPCSE",
    "NLQDMC",
    "PID",
    "BasalBolus",
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
    "Paced",
    "StateTuning",
    "Status",
    "design_basal_bolus",
    "design_imc",
    "design_linear_mpc",
    "design_meal_mpc",
    "design_mpc_se",
    "design_nlqdmc_se",
    "design_open_loop",
    "design_pid",
    "guarded",
    "internal_model_tuning",
    "paced",
]

_HOME: Final = {
    name: module
    for module, names in {
        "basal_bolus": ("BasalBolus", "design_basal_bolus"),
        "guard": ("Guard", "GuardSettings", "guarded"),
        "imc": ("IMC", "design_imc"),
        "linear_mpc": ("LinearMPC", "design_linear_mpc"),
        "meal_mpc": ("MealMPC", "design_meal_mpc"),
        "mpc_se": ("MPCSE", "design_mpc_se"),
        "nlqdmc_se": ("NLQDMC", "design_nlqdmc_se"),
        "open_loop": ("OpenLoop", "design_open_loop"),
        "pace": ("Paced", "paced"),
        "pid": ("PID", "PIDTuning", "design_pid", "internal_model_tuning"),
        "protocol": ("Controller", "Decision", "Observation", "Status"),
        "settings": ("MealTuning", "MPCTuning", "StateTuning"),
    }.items()
    for name in names
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'glucoloop.control' has no attribute {name!r}")
    return getattr(importlib.import_module(f"glucoloop.control.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
