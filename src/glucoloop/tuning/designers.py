"""Designs of controllers in which only the tuning is left open."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import jax.numpy as jnp
from jax.typing import ArrayLike

from glucoloop.control import (
    MPCSE,
    Controller,
    MPCTuning,
    StateTuning,
    design_linear_mpc,
    design_mpc_se,
    design_nlqdmc_se,
)
from glucoloop.control.parker1999 import MEASUREMENT_VARIANCE, PARKER_1999
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients import Patient
from glucoloop.patients.capabilities import process_noise as noise_of_states
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.registry.controllers import TUNABLE, controller_entry
from glucoloop.simulation import identify, linear_model, nonlinear_model

Designer = Callable[[MPCTuning], Controller]
"""Function from a tuning to a controller."""


def uses_reference_filter(controller: str) -> bool:
    """Whether phi_r is among the tuned parameters.

    Raises
    ------
    ValueError
        For a controller that is not known here.
    """
    if not controller_entry(controller).tunable:
        raise ValueError(f"the controller {controller!r} cannot be tuned; the known ones are: {', '.join(TUNABLE)}")
    return any(setting.name == "reference_filter" for setting in controller_entry(controller).settings)


def designer(
    controller: str,
    patient: Patient,
    *,
    model: StepResponseModel | None = None,
    process_noise: ArrayLike | None = None,
    measurement_variance: float = MEASUREMENT_VARIANCE,
    limits: DoseLimits = PARKER_1999_LIMITS,
    sample_time_min: float = 5.0,
    dead_time_samples: int = 0,
) -> Designer:
    """Make a design that is a function of the tuning alone.

    Parameters
    ----------
    controller : {"mpc", "mpc-se", "nlqdmc-se"}
    patient : Patient
        Patient whose linearised or nonlinear model the controllers with state estimation use.
    model : StepResponseModel, optional
        Model of linear MPC, without the dead time; by default one is identified from a noise-free record.
    process_noise : (n,) or (n, n) array, optional
        Q of the controllers with state estimation; by default the reading of the paper at setpoint-81 without noise.
    measurement_variance : float
        R of the controllers with state estimation, (mg/dl)^2.
    limits : DoseLimits
    sample_time_min : float
    dead_time_samples : int
        Dead time that the controller knows of; its horizon grows by as much.

    Raises
    ------
    ValueError
        For an unknown controller.
    """
    if not uses_reference_filter(controller):
        told = identify(patient, sample_time_min=sample_time_min).model if model is None else model
        told = told.delayed(dead_time_samples)

        def linear(tuning: MPCTuning) -> Controller:
            longer = tuning.prediction_horizon + dead_time_samples
            return design_linear_mpc(told, dataclasses.replace(tuning, prediction_horizon=longer), limits)

        return linear
    if process_noise is None:
        process_noise = noise_of_states(patient, *PARKER_1999["setpoint-81", False].noise)
    if controller == "nlqdmc-se":
        nonlinear = nonlinear_model(patient, sample_time_min=sample_time_min)

        def nlqdmc(tuning: MPCTuning) -> Controller:
            return design_nlqdmc_se(
                nonlinear,
                process_noise,
                _with_reference(tuning),
                limits,
                measurement_variance=measurement_variance,
                dead_time_samples=dead_time_samples,
            )

        return nlqdmc
    linearised = linear_model(patient, sample_time_min=sample_time_min)

    @functools.cache
    def unfiltered(tuning: StateTuning) -> MPCSE:
        return design_mpc_se(
            linearised,
            process_noise,
            tuning,
            limits,
            measurement_variance=measurement_variance,
            dead_time_samples=dead_time_samples,
        )

    def mpc_se(tuning: MPCTuning) -> Controller:
        tuning = _with_reference(tuning)
        # The filter shapes the reference alone: a grid of filters needs one design.
        base = unfiltered(dataclasses.replace(tuning, reference_filter=0.0))
        longer = dataclasses.replace(tuning, prediction_horizon=tuning.prediction_horizon + dead_time_samples)
        return dataclasses.replace(base, reference=jnp.asarray(longer.reference()))

    return mpc_se


def _with_reference(tuning: MPCTuning) -> StateTuning:
    if not isinstance(tuning, StateTuning):
        raise ValueError("the controller follows a filtered reference; give the grid reference filters")
    return tuning
