"""Input of the design of a controller: models and limits, but never a patient; and checks of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Protocol

from glucoloop._lazy_jax import jax, np, npt
from glucoloop.arguments import ArgumentTypeError, is_traced
from glucoloop.models.nonlinear import FedModel
from glucoloop.models.state_space import LinearModel
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps.limits import BolusLimits, DoseLimits
from glucoloop.refusal import Refusal
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
        """The patient linearised at steady state at the setpoint."""

    def nonlinear(self) -> FedModel:
        """The equations of the patient, at steady state at the setpoint."""

    def first_order(self, step_mU_min: float | None, delay_min: float | None = None) -> FirstOrderModel:
        """First-order model with dead time, fitted to the response to a lasting step of insulin.

        For None the step is the default one, and the dead time is fitted too.
        """

    def process_noise(self, glucose: float, other: float, glucagon: float) -> npt.NDArray[np.float64]:
        """Diagonal of Q ``(states,)`` of a filter for the models, from variances of three kinds of states."""


def check_sample_time(sample_time_min: float) -> None:
    """Refuse a sample time that is not positive and finite, or not known yet."""
    if is_traced(sample_time_min):
        raise ArgumentTypeError(
            "sample_time_min is traced by JAX, but it decides how many samples there are; give a plain number, "
            "or make it a static field: equinox.field(static=True)"
        )
    if not 0.0 < sample_time_min < math.inf:
        raise Refusal(f"a sample time of {sample_time_min:g} min is not possible; give a finite value above 0")


def check_number(called: str, value: Any, unit: str = "", *, at_least: float | None = None) -> None:
    """Refuse a number that is not finite, or not above 0, or less than the minimum; None and what JAX traces pass."""
    if value is None or is_traced(value):
        return
    if not (math.isfinite(value) and (value > 0.0 if at_least is None else value >= at_least)):
        bound = "above 0" if at_least is None else f"of {at_least:g} or more"
        article = "an" if called[0] in "aeio" else "a"
        raise Refusal(
            f"{article} {called} of {value:g}{unit and ' '}{unit} is not possible; give a finite value {bound}"
        )


def check_rate(called: str, insulin_mU_min: float, limits: DoseLimits) -> None:
    """Refuse a constant rate that a pump cannot deliver; one that JAX traces passes."""
    if is_traced(insulin_mU_min, limits):
        return
    if not (math.isfinite(insulin_mU_min) and limits.min_mU_min <= insulin_mU_min <= limits.max_mU_min):
        raise Refusal(
            f"a {called} rate of {insulin_mU_min:g} mU/min is not possible; "
            f"give one from {limits.min_mU_min:g} to {limits.max_mU_min:g} mU/min"
        )


def check_gain(gain: jax.typing.ArrayLike) -> None:
    """Refuse a model in which insulin raises glucose, since its controller would give more insulin at low glucose.

    A gain that JAX traces has no value yet, and passes.
    """
    if not is_traced(gain) and not -math.inf < float(np.asarray(gain)) < 0.0:
        raise Refusal(
            f"a gain of {float(np.asarray(gain)):g} mg/dl per mU/min is not possible; insulin lowers glucose, so the "
            "gain of a model is below 0. Check the sign, or identify the model again from a record in which insulin "
            "changes more"
        )
