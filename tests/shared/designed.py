"""What designs may know of a patient of whom a test makes up the models."""

import dataclasses
from typing import Any

from glucoloop.identification import FirstOrderModel
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS, BolusLimits, DoseLimits
from glucoloop.therapy import Profile


@dataclasses.dataclass(frozen=True, kw_only=True)
class Designed:
    """Implements `control.design_case.DesignCase` but for the process noise."""

    linear: Any
    identified: StepResponseModel
    first: FirstOrderModel
    basal_insulin_mU_min: float
    setpoint_mg_dl: float = 81.3
    imagined: Any = None
    dead_time_samples: int = 0
    noise_variance: float = 1.45
    sample_time_min: float = 5.0
    limits: DoseLimits = PARKER_1999_LIMITS
    bolus: BolusLimits = DEFAULT_BOLUS_LIMITS

    @property
    def profile(self):
        return Profile(basal_mU_min=self.basal_insulin_mU_min, setpoint_mg_dl=self.setpoint_mg_dl)

    def behind_lag(self, lag_min):
        assert not lag_min
        return self

    def linearised(self):
        return self.linear

    def nonlinear(self):
        return self.imagined

    def first_order(self, step_mU_min, delay_min=None):
        del step_mU_min
        return self.first if delay_min is None else dataclasses.replace(self.first, delay_min=delay_min)
