"""glucoloop: an open laboratory for automatic insulin dosing. Research software, not a medical device.

The names below are the everyday interface; they are imported when first used, so that `import glucoloop` and
``glucoloop --help`` answer at once. Everything else lives in the layers, which are imported in the same way:
`glucoloop.patients`, `glucoloop.control` and so on.

Importing glucoloop switches JAX to float64 for the whole process, for controllers are designed in it; nothing else of
JAX changes. See `glucoloop.arithmetic`.
"""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, Any

from glucoloop.arithmetic import use_float64

if TYPE_CHECKING:
    from glucoloop.bounds import optimal_doses
    from glucoloop.cohorts.people_run import simulate_people
    from glucoloop.control import (
        GuardSettings,
        MealTuning,
        MPCTuning,
        PIDTuning,
        StateTuning,
        design_imc,
        design_linear_mpc,
        design_meal_mpc,
        design_mpc_se,
        design_nlqdmc_se,
        design_open_loop,
        design_pid,
        guarded,
    )
    from glucoloop.estimation.unknown_meal import MealHabits, estimate_meals
    from glucoloop.exercise import Exercise
    from glucoloop.identification import identify_record, record_from_samples
    from glucoloop.meals import Meal, Scenario
    from glucoloop.metrics import summarise
    from glucoloop.patients import at_basal, at_setpoint, patient, population, virtual_people
    from glucoloop.pumps import LimitedPump, dose_limits, with_resolution
    from glucoloop.refusal import Refusal
    from glucoloop.report import plot
    from glucoloop.rhythms import rhythm
    from glucoloop.sensors import dead_time, white_noise
    from glucoloop.shown_units import showing
    from glucoloop.simulation import (
        Adaptive,
        Exponential,
        Stepper,
        excite,
        fit_step,
        identify,
        linear_model,
        nonlinear_model,
        simulate,
        usual_limits,
    )

__version__ = "0.1.0"

use_float64()

_HOME = {
    name: module
    for module, names in {
        "bounds": ("optimal_doses",),
        "cohorts.people_run": ("simulate_people",),
        "control": (
            "GuardSettings",
            "MPCTuning",
            "MealTuning",
            "PIDTuning",
            "StateTuning",
            "design_imc",
            "design_linear_mpc",
            "design_meal_mpc",
            "design_mpc_se",
            "design_nlqdmc_se",
            "design_open_loop",
            "design_pid",
            "guarded",
        ),
        "estimation.unknown_meal": ("MealHabits", "estimate_meals"),
        "exercise": ("Exercise",),
        "identification": ("identify_record", "record_from_samples"),
        "meals": ("Meal", "Scenario"),
        "metrics": ("summarise",),
        "patients": ("at_basal", "at_setpoint", "patient", "population", "virtual_people"),
        "pumps": ("LimitedPump", "dose_limits", "with_resolution"),
        "refusal": ("Refusal",),
        "report": ("plot",),
        "rhythms": ("rhythm",),
        "sensors": ("dead_time", "white_noise"),
        "shown_units": ("showing",),
        "simulation": (
            "Adaptive",
            "Explicit",
            "Exponential",
            "Stepper",
            "excite",
            "fit_step",
            "identify",
            "linear_model",
            "nonlinear_model",
            "simulate",
            "usual_limits",
        ),
    }.items()
    for name in names
}

__all__ = [
    "Adaptive",
    "Exercise",
    "Explicit",
    "Exponential",
    "GuardSettings",
    "LimitedPump",
    "MPCTuning",
    "Meal",
    "MealHabits",
    "MealTuning",
    "PIDTuning",
    "Refusal",
    "Scenario",
    "StateTuning",
    "Stepper",
    "at_basal",
    "at_setpoint",
    "dead_time",
    "design_imc",
    "design_linear_mpc",
    "design_meal_mpc",
    "design_mpc_se",
    "design_nlqdmc_se",
    "design_open_loop",
    "design_pid",
    "dose_limits",
    "estimate_meals",
    "excite",
    "fit_step",
    "guarded",
    "identify",
    "identify_record",
    "linear_model",
    "nonlinear_model",
    "optimal_doses",
    "patient",
    "plot",
    "population",
    "record_from_samples",
    "rhythm",
    "showing",
    "simulate",
    "simulate_people",
    "summarise",
    "usual_limits",
    "virtual_people",
    "white_noise",
    "with_resolution",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"glucoloop.{_HOME[name]}"), name)
    if not name.startswith("_") and importlib.util.find_spec(f"glucoloop.{name}") is not None:
        return importlib.import_module(f"glucoloop.{name}")
    raise AttributeError(f"module 'glucoloop' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
