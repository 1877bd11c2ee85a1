"""Input of the design of a controller: models and limits, but never a patient."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from glucoloop._lazy_jax import np, npt
from glucoloop.models.nonlinear import FedModel
from glucoloop.models.state_space import LinearModel
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps.limits import BolusLimits, DoseLimits
from glucoloop.therapy import Profile

if TYPE_CHECKING:
    from glucoloop.identification import FirstOrderModel


class DesignCase(Protocol):
    """Subject of the design of a controller; `build.designs` makes it from a situation."""

    @property
    def limits(self) -> DoseLimits:
        """Limits of the pump."""

    @property
    def bolus(self) -> BolusLimits:
        """Limits of a bolus of the pump."""

    @property
    def sample_time_min(self) -> float:
        """Time between two readings, and between two doses."""

    @property
    def noise_variance(self) -> float:
        """Noise variance of the readings, (mg/dl)^2."""

    @property
    def dead_time_samples(self) -> int:
        """Dead time that the controller knows, 0 if it does not know it."""

    @property
    def basal_insulin_mU_min(self) -> float:
        """The patient's basal rate."""

    @property
    def profile(self) -> Profile:
        """Profile of the person: basal rate, setpoint, carbohydrate ratio, correction factor, weight and daily dose.

        A controller that doses by it has a method ``with_profile``, by which people of a trial each bring their own.
        """

    @property
    def identified(self) -> StepResponseModel:
        """Step response identified from a record, delayed by the known dead time; TypeError where it is not used."""

    def behind_lag(self, lag_min: float) -> DesignCase:
        """The same case with a sensor that lags, whose reading is one more state of its models; 0: no lag."""

    def linearised(self) -> LinearModel:
        """The patient linearised at rest at the setpoint."""

    def nonlinear(self) -> FedModel:
        """The equations of the patient, at rest at the setpoint."""

    def first_order(self, step_mU_min: float | None, delay_min: float | None = None) -> FirstOrderModel:
        """First-order model with dead time, fitted to the response to a lasting step of insulin.

        For None the step is the usual one, and the dead time is fitted too.
        """

    def process_noise(self, glucose: float, other: float, glucagon: float) -> npt.NDArray[np.float64]:
        """Diagonal of Q ``(states,)`` of a filter for the models, from variances of three kinds of states."""
