"""How the controllers of the catalogue are designed for a patient, a model and a tuning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.control import (
    MPCSE,
    NLQDMC,
    Controller,
    Guard,
    GuardSettings,
    MealMPC,
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
    internal_model_tuning,
)
from glucoloop.estimation.unknown_meal import MealHabits
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients import Patient, SorensenPatient
from glucoloop.pumps import DoseLimits
from glucoloop.simulation import fit_step, identify, linear_model, nonlinear_model
from glucoloop.trials.catalogue import Value, controller_entry
from glucoloop.trials.guard_catalogue import PREFIX
from glucoloop.trials.situation import record_key, sensor_of
from glucoloop.trials.trial import Trial, TrialCase


@dataclass(frozen=True)
class DesignCase:
    """What a controller may be designed on."""

    patient: Patient
    """For designs on a linearised or nonlinear model of the patient."""
    model: StepResponseModel | None
    """Identified, and told of the known dead time; None for a controller that does not use one."""
    limits: DoseLimits
    sample_time_min: float
    noise_variance: float
    """Of the readings."""
    dead_time_samples: int
    """As the controller is to know it: 0 where it is not told."""

    @property
    def identified(self) -> StepResponseModel:
        """The model, for a design that needs one."""
        if self.model is None:
            raise TypeError("the catalogue says that this controller uses no model, but its design asks for one")
        return self.model


def controller_of(trial: Trial, case: TrialCase, nominal: SorensenPatient, limits: DoseLimits) -> Controller:
    """The controller of a trial's case, designed for the nominal patient.

    Raises
    ------
    ValueError
        For a design that is not possible.
    """
    entry = controller_entry(case.controller)
    known_samples = trial.dead_time_samples if case.known_dead_time else 0
    model = None
    if entry.uses_model:
        identified = identify(
            nominal,
            sensor_of(case.model_noise_variance or 0.0, trial.noise_bound_mg_dl, 0),
            record_key(trial.seed),
            memory=case.memory or 0,
            laguerre_pole=case.laguerre_pole or 0.0,
            laguerre_functions=case.laguerre_functions or None,
            sample_time_min=trial.sample_time_min,
        )
        model = identified.model.delayed(known_samples)
    design = DesignCase(
        patient=nominal,
        model=model,
        limits=limits,
        sample_time_min=trial.sample_time_min,
        noise_variance=trial.noise_variance,
        dead_time_samples=known_samples,
    )
    return with_guard(entry.designer()(design, **case.tuning), case.guard, limits)


def with_guard(controller: Controller, guard: Mapping[str, Value] | None, limits: DoseLimits) -> Controller:
    """A controller with the guard that is asked for, if any: its limits as in `guard_catalogue`.

    Raises
    ------
    ValueError
        For a limit out of its bounds.
    """
    if guard is None:
        return controller
    given = {key.removeprefix(PREFIX): float(value) for key, value in guard.items()}
    return guarded(controller, GuardSettings(**given), limits)


def told_of_basal(controller: Controller, basal_insulin_mU_min: npt.NDArray[np.float64]) -> Controller:
    """A controller for people whose basal rates are the ones given.

    Those that hold the basal rate of the patient they were designed for are given each person's own; the others take
    it from the pump when they wake, and are handed back as they are.
    """
    if isinstance(controller, MPCSE | NLQDMC | MealMPC | Guard):
        return controller.with_basal(jnp.asarray(basal_insulin_mU_min))
    return controller


def linear_mpc(
    case: DesignCase,
    *,
    move_horizon: int,
    prediction_horizon: int,
    output_weight: float,
    move_weight: float,
    constraints: str,
    glucose_floor_mg_dl: float,
    floor_weight: float,
) -> Controller:
    """Linear MPC; a known dead time lengthens its horizon, so that it looks as far past it as before."""
    tuning = MPCTuning(
        move_horizon=move_horizon,
        prediction_horizon=prediction_horizon + case.dead_time_samples,
        output_weight=output_weight,
        move_weight=move_weight,
    )
    return design_linear_mpc(
        case.identified,
        tuning,
        case.limits,
        constraints=constraints,
        glucose_floor_mg_dl=glucose_floor_mg_dl,
        floor_weight=floor_weight,
    )


def process_noise(tuning: Mapping[str, Value]) -> npt.NDArray[np.float64]:
    """Diagonal of Q for the 8 glucose, 9 other and 2 glucagon states, of the settings of a controller."""
    return _process_noise(*(float(tuning[f"{kind}_process_noise"]) for kind in ("glucose", "other", "glucagon")))


def _process_noise(glucose: float, other: float, glucagon: float) -> npt.NDArray[np.float64]:
    return np.repeat([glucose, other, glucagon], [8, 9, 2])


def mpc_se(
    case: DesignCase,
    *,
    move_horizon: int,
    prediction_horizon: int,
    output_weight: float,
    move_weight: float,
    reference_filter: float,
    reference_start: int,
    glucose_process_noise: float,
    other_process_noise: float,
    glucagon_process_noise: float,
    measurement_variance: float,
    offset_free: str,
    constraints: str,
    glucose_floor_mg_dl: float,
    floor_weight: float,
) -> Controller:
    """MPC with state estimation, on the patient linearised at his operating point."""
    return design_mpc_se(
        linear_model(case.patient, sample_time_min=case.sample_time_min),
        _process_noise(glucose_process_noise, other_process_noise, glucagon_process_noise),
        StateTuning(move_horizon, prediction_horizon, output_weight, move_weight, reference_filter, reference_start),
        case.limits,
        measurement_variance=measurement_variance,
        offset_free=offset_free,
        dead_time_samples=case.dead_time_samples,
        constraints=constraints,
        glucose_floor_mg_dl=glucose_floor_mg_dl,
        floor_weight=floor_weight,
    )


def nlqdmc_se(
    case: DesignCase,
    *,
    move_horizon: int,
    prediction_horizon: int,
    output_weight: float,
    move_weight: float,
    reference_filter: float,
    reference_start: int,
    glucose_process_noise: float,
    other_process_noise: float,
    glucagon_process_noise: float,
    measurement_variance: float,
    glucose_floor_mg_dl: float,
    floor_weight: float,
) -> Controller:
    """NLQDMC with state estimation, on the patient's own equations."""
    return design_nlqdmc_se(
        nonlinear_model(case.patient, sample_time_min=case.sample_time_min),
        _process_noise(glucose_process_noise, other_process_noise, glucagon_process_noise),
        StateTuning(move_horizon, prediction_horizon, output_weight, move_weight, reference_filter, reference_start),
        case.limits,
        measurement_variance=measurement_variance,
        dead_time_samples=case.dead_time_samples,
        glucose_floor_mg_dl=glucose_floor_mg_dl,
        floor_weight=floor_weight,
    )


_LEAST_VARIANCE: Final = 0.01
"""(mg/dl)^2 that a filter expects of readings without noise."""


def meal_mpc(
    case: DesignCase,
    *,
    move_horizon: int,
    prediction_horizon: int,
    output_weight: float,
    move_weight: float,
    estimator: str,
    meal_horizon: int,
    meals_per_h: float,
    mean_carbs_g: float,
    disturbance_variance: float,
    measurement_variance: float,
    caution_weight: float,
    caution_mg_dl: float,
    anticipation: float,
    iterations: int,
    individual_by: str,
    glucose_floor_mg_dl: float,
    floor_weight: float,
) -> Controller:
    """Meal-aware nonlinear MPC, on the patient's own equations."""
    del individual_by  # see `individual_meal_mpc`
    tuning = MealTuning(
        move_horizon=move_horizon,
        prediction_horizon=prediction_horizon,
        output_weight=output_weight,
        move_weight=move_weight,
        caution_weight=caution_weight,
        caution_mg_dl=caution_mg_dl,
        glucose_floor_mg_dl=glucose_floor_mg_dl,
        floor_weight=floor_weight,
        anticipation=anticipation,
        iterations=iterations,
    )
    return design_meal_mpc(
        nonlinear_model(case.patient, sample_time_min=case.sample_time_min),
        tuning,
        case.limits,
        habits=MealHabits(meals_per_h=meals_per_h, mean_carbs_g=mean_carbs_g),
        estimator=estimator,
        meal_horizon=meal_horizon,
        disturbance_variance=disturbance_variance,
        measurement_variance=measurement_variance or max(case.noise_variance, _LEAST_VARIANCE),
        dead_time_samples=case.dead_time_samples,
    )


def imc(case: DesignCase, *, filter_min: float, delay_min: float) -> Controller:
    """IMC on a first-order model of the patient; a known dead time is added to the model's own."""
    model = fit_step(case.patient, delay_min=delay_min, sample_time_min=case.sample_time_min)
    return design_imc(
        float(model.gain),
        float(model.tau_min),
        delay_min + case.dead_time_samples * case.sample_time_min,
        case.limits,
        filter_min=filter_min,
        sample_time_min=case.sample_time_min,
    )


def pid(
    case: DesignCase, *, closed_loop_min: float, gain: float, integral_time_min: float, derivative_time_min: float
) -> Controller:
    """PID; what is not given comes from a first-order model of the patient, a known dead time included."""
    model = fit_step(case.patient, delay_min=None, sample_time_min=case.sample_time_min)
    delay_min = float(model.delay_min) + case.dead_time_samples * case.sample_time_min
    fitted = internal_model_tuning(float(model.gain), float(model.tau_min), delay_min, closed_loop_min)
    tuning = PIDTuning(
        gain_mU_min_per_mg_dl=gain or fitted.gain_mU_min_per_mg_dl,
        integral_time_min=integral_time_min or fitted.integral_time_min,
        derivative_time_min=fitted.derivative_time_min if derivative_time_min == -1.0 else derivative_time_min,
    )
    return design_pid(tuning, case.limits, sample_time_min=case.sample_time_min)


def basal(case: DesignCase) -> Controller:
    """A constant rate."""
    return design_open_loop(limits=case.limits, sample_time_min=case.sample_time_min)
