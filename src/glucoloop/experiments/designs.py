"""How the controllers of the catalogue are designed for a patient, a model and a tuning."""

from __future__ import annotations

import dataclasses
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.control import (
    Controller,
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
    internal_model_tuning,
)
from glucoloop.estimation.unknown_meal import MealHabits
from glucoloop.experiments.case import Case
from glucoloop.experiments.chance import record_key
from glucoloop.experiments.situation import Situation
from glucoloop.experiments.surroundings import sensor_of
from glucoloop.identification import Identification
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients import Patient
from glucoloop.patients.capabilities import process_noise
from glucoloop.pumps import DoseLimits
from glucoloop.registry.controllers import ControllerEntry, controller_entry
from glucoloop.registry.guard import PREFIX
from glucoloop.registry.patients import patient_entry
from glucoloop.registry.settings import Value
from glucoloop.simulation import fit_step, identify, linear_model, nonlinear_model


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


def controller_of(
    situation: Situation,
    case: Case,
    patient: Patient | None = None,
    model: StepResponseModel | None = None,
    *,
    model_is_late: bool = False,
) -> Controller:
    """The controller of a case.

    Parameters
    ----------
    situation : Situation
    case : Case
    patient : Patient, optional
        For whom it is designed; the nominal patient by default.
    model : StepResponseModel, optional
        On which it is designed, if it uses one; by default one is identified from the patient.
    model_is_late : bool
        Whether that model holds the dead time already.

    Raises
    ------
    ValueError
        For a design that is not possible.
    """
    patient = situation.nominal if patient is None else patient
    entry = controller_entry(case.controller)
    known_samples = situation.dead_time_samples if case.known_dead_time else 0
    if entry.uses_model and model is None:
        model = identified_model(situation, case, patient).model
    design = DesignCase(
        patient=patient,
        model=model if model is None or model_is_late else model.delayed(known_samples),
        limits=situation.limits,
        sample_time_min=situation.sample_time_min,
        noise_variance=situation.noise_variance,
        dead_time_samples=known_samples,
    )
    return with_guard(_designed(entry, design, case.tuning), case.guard, situation.limits)


def _designed(entry: ControllerEntry, design: DesignCase, tuning: Mapping[str, Value]) -> Controller:
    designer = entry.designer()
    try:
        controller: Controller = designer(design, **tuning)
    except ValueError as error:
        [*_, (frame, _)] = traceback.walk_tb(error.__traceback__)
        raised_by = str(frame.f_globals.get("__name__"))
        if raised_by.partition(".")[0] != designer.__module__.partition(".")[0]:
            raise
        # somebody else's package refuses its settings: as much the user's mistake as where this one does
        raise ValueError(str(error)) from error
    return controller


def identified_model(situation: Situation, case: Case, patient: Patient) -> Identification:
    """The model of a case, identified from the pulse experiment on a patient.

    Raises
    ------
    ValueError
        For an experiment that is not possible.
    """
    return identify(
        patient,
        sensor_of(case.model_noise_variance or 0.0, situation.noise_bound_mg_dl, 0, situation.site),
        record_key(situation.seed),
        memory=case.memory or 0,
        amplitude_mU_min=pulse_of(situation, float(patient.basal_insulin_mU_min)),
        laguerre_pole=case.laguerre_pole or 0.0,
        laguerre_functions=case.laguerre_functions or None,
        sample_time_min=situation.sample_time_min,
    )


def pulse_of(situation: Situation, basal_insulin_mU_min: float) -> float:
    """Height of the pulses of the experiment: what is usual for the patient, and at most the basal rate."""
    return min(patient_entry(situation.patient).pulse_mU_min, basal_insulin_mU_min)


def with_guard(
    controller: Controller,
    guard: Mapping[str, Value] | None,
    limits: DoseLimits,
    basal_insulin_mU_min: jax.Array | None = None,
) -> Controller:
    """A controller with the guard that is asked for, if any: its limits as in `registry.guard`.

    The guard holds the basal rates ``(people,)`` that are given; None: the rate at which the loop starts.

    Raises
    ------
    ValueError
        For a limit out of its bounds.
    """
    if guard is None:
        return controller
    given = {key.removeprefix(PREFIX): float(value) for key, value in guard.items()}
    guard_of_all = guarded(controller, GuardSettings(**given), limits)
    if basal_insulin_mU_min is None:
        return guard_of_all
    return dataclasses.replace(guard_of_all, basal_mU_min=basal_insulin_mU_min)


def with_individual_basal(controller: Controller, basal_insulin_mU_min: npt.ArrayLike) -> Controller:
    """A controller for people whose basal rates are the ones given.

    A controller that holds the basal rate of the patient it was designed for has a method ``with_basal``, which gives
    it each person's own; the others take the rate from the pump when they start, and are handed back as they are.
    """
    own = getattr(controller, "with_basal", None)
    if own is None:
        return controller
    individual: Controller = own(jnp.asarray(basal_insulin_mU_min))
    return individual


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


def process_noise_of(patient: Patient, tuning: Mapping[str, Value]) -> npt.NDArray[np.float64]:
    """Diagonal of Q ``(states,)`` of a filter on a patient, of the settings of a controller."""
    return process_noise(patient, *(float(tuning[f"{kind}_process_noise"]) for kind in _KINDS))


_KINDS: Final = ("glucose", "other", "glucagon")


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
        process_noise(case.patient, glucose_process_noise, other_process_noise, glucagon_process_noise),
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
        process_noise(case.patient, glucose_process_noise, other_process_noise, glucagon_process_noise),
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


def imc(case: DesignCase, *, filter_min: float, delay_min: float, step_mU_min: float) -> Controller:
    """IMC on a first-order model of the patient; a known dead time is added to the model's own."""
    model = fit_step(
        case.patient, step_mU_min=step_mU_min or None, delay_min=delay_min, sample_time_min=case.sample_time_min
    )
    return design_imc(
        float(model.gain),
        float(model.tau_min),
        delay_min + case.dead_time_samples * case.sample_time_min,
        case.limits,
        filter_min=filter_min,
        sample_time_min=case.sample_time_min,
    )


def pid(
    case: DesignCase,
    *,
    closed_loop_min: float,
    gain: float,
    integral_time_min: float,
    derivative_time_min: float,
    step_mU_min: float,
) -> Controller:
    """PID; what is not given comes from a first-order model of the patient, a known dead time included."""
    model = fit_step(
        case.patient, step_mU_min=step_mU_min or None, delay_min=None, sample_time_min=case.sample_time_min
    )
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
