"""How the controllers of the catalogue are designed for a patient, a model and a tuning."""

from __future__ import annotations

from dataclasses import dataclass

from glucoloop.control import Controller, MPCTuning, design_linear_mpc
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients import Patient
from glucoloop.pumps import DoseLimits


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


def linear_mpc(
    case: DesignCase,
    *,
    move_horizon: int,
    prediction_horizon: int,
    output_weight: float,
    move_weight: float,
    constraints: str,
) -> Controller:
    """Linear MPC; a known dead time lengthens its horizon, so that it looks as far past it as before."""
    tuning = MPCTuning(
        move_horizon=move_horizon,
        prediction_horizon=prediction_horizon + case.dead_time_samples,
        output_weight=output_weight,
        move_weight=move_weight,
    )
    return design_linear_mpc(case.identified, tuning, case.limits, constraints=constraints)
