"""What the design of a controller is handed: models and limits, but never a patient."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from glucoloop.identification import FirstOrderModel
from glucoloop.models.nonlinear import FedModel
from glucoloop.models.state_space import LinearModel
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps.limits import DoseLimits


class DesignCase(Protocol):
    """Whom and what a controller is designed for; `experiments.designs` makes it of a situation."""

    @property
    def limits(self) -> DoseLimits:
        """Of the pump."""
        ...

    @property
    def sample_time_min(self) -> float:
        """Time between two readings, and between two doses."""
        ...

    @property
    def noise_variance(self) -> float:
        """Of the readings, (mg/dl)^2."""
        ...

    @property
    def dead_time_samples(self) -> int:
        """As the controller is to know it: 0 where it is not told."""
        ...

    @property
    def identified(self) -> StepResponseModel:
        """Step response identified from a record, late by the known dead time.

        Raises
        ------
        TypeError
            For a controller whose entry says that it uses no identified model.
        """
        ...

    def linearised(self) -> LinearModel:
        """The patient linearised at the operating point."""
        ...

    def nonlinear(self) -> FedModel:
        """The equations of the patient."""
        ...

    def first_order(self, step_mU_min: float | None, delay_min: float | None = None) -> FirstOrderModel:
        """First-order model with dead time, fitted to the answer to a lasting step of insulin.

        None: the usual step, and a dead time that is fitted too.
        """
        ...

    def process_noise(self, glucose: float, other: float, glucagon: float) -> npt.NDArray[np.float64]:
        """Diagonal of Q ``(states,)`` of a filter on the patient, from variances of three kinds of states."""
        ...
