"""Prediction horizon that suits a model: a controller that sees too little of the effect of insulin gives too much.

The controller asks for a change of the rate of about the error over S_p, while one of the error over the gain is
needed: it gives 1 / share times too much, and takes it back when glucose falls.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final, TypeAlias, TypeVar

from glucoloop._lazy_jax import jnp, np, npt
from glucoloop.arguments import is_traced
from glucoloop.control.design_case import check_gain
from glucoloop.control.tuning import LONGEST_PREDICTION_HORIZON, MPCTuning
from glucoloop.models.nonlinear import NonlinearModel
from glucoloop.models.state_space import LinearModel, discretise, linearise, step_response
from glucoloop.models.step_response import StepResponseModel, extended
from glucoloop.refusal import Refusal

Floats: TypeAlias = "npt.NDArray[np.float64]"

MIN_SHARE: Final = 0.05
"""Minimum share of its gain that the response of a model has at the horizon.

Linear MPC with 50 g of glucose, on models identified from hovorka-2004 and wilinska-2010 without noise: with 1.8 % (18
samples of wilinska-2010) glucose falls to 47 to 63 mg/dl for move weights of 0 to 3, with 3 to 4.1 % to 33 to 78, and
from 5.4 % on a move weight of 1 or 3 keeps it at 76 or above. Without a move weight it still falls to 44 with 5.4 %, to
65 with 11 %, and to 74 with 20 %.
"""
DEFAULT_SHARE: Final = 0.3
"""Share at the default horizon, with which glucose stays at 84 mg/dl or above without a move weight. The paper's
horizons of 7 and 8 samples see as much of its patient.
"""

Tuning = TypeVar("Tuning", bound=MPCTuning)


def identified_response(model: StepResponseModel) -> tuple[Any, Any]:
    """Step response over the longest horizon, and gain, of an identified model."""
    return extended(model.step_response, model.realisation, LONGEST_PREDICTION_HORIZON), model.gain


def linear_response(model: LinearModel) -> tuple[Any, Any]:
    """Step response over the longest horizon, and gain, of a linear model."""
    gain = model.C @ jnp.linalg.solve(jnp.eye(model.Gamma.size) - model.Phi, model.Gamma)
    return step_response(model, LONGEST_PREDICTION_HORIZON), gain


def response_at_rest(model: NonlinearModel) -> tuple[Any, Any]:
    """Step response and gain of a nonlinear model, linearised at steady state."""
    linear = linearise(model.derivative, model.glucose_mg_dl, model.state, model.insulin_mU_min)
    return linear_response(discretise(linear, model.sample_time_min))


def suited(tuning: Tuning, response: Any, gain: Any, *, usual: int = 1) -> Tuning:
    """A tuning with a horizon that suits the model, but at least `usual`, if its own is 0, and unchanged otherwise.

    A gain that is not below 0, or a response ``(N,)`` that at the horizon has less than `MIN_SHARE` of it, is
    refused.
    """
    if is_traced(response, gain):
        return tuning if tuning.prediction_horizon else dataclasses.replace(tuning, prediction_horizon=usual)
    check_gain(gain)
    share = _share(response, gain)
    if not tuning.prediction_horizon:
        horizon = max(usual, tuning.move_horizon, _samples_until(DEFAULT_SHARE, share) or LONGEST_PREDICTION_HORIZON)
        tuning = dataclasses.replace(tuning, prediction_horizon=horizon)
    seen = float(share[min(tuning.prediction_horizon, share.size) - 1])
    if not seen >= MIN_SHARE:
        enough = least_horizon(response, gain)
        mend = (
            "design on another model"
            if enough is None
            else f"give a prediction horizon of {enough} or more, or 0 for one that suits the model"
        )
        raised = ", so that insulin seems to raise glucose" if seen < 0.0 else ""
        raise Refusal(
            f"a prediction horizon of {tuning.prediction_horizon} samples sees {100.0 * seen:.2g} % of the gain of "
            f"insulin{raised}; a controller that sees less than {100.0 * MIN_SHARE:g} % gives far too much or too "
            f"little, so {mend}"
        )
    return tuning


def least_horizon(response: Any, gain: Any) -> int | None:
    """Shortest horizon that `suited` accepts, from which on every longer one is; None without any."""
    return _samples_until(MIN_SHARE, _share(response, gain))


def unseen(step_response: Floats, gain: Floats, horizon: int) -> Floats:
    """Indicator ``(people,)`` of responses with less than `MIN_SHARE` of their gain at the horizon."""
    with np.errstate(invalid="ignore", divide="ignore"):
        seen = (gain < 0.0) & (step_response[horizon - 1] / gain >= MIN_SHARE)
    hidden: Floats = ~seen
    return hidden


def _share(response: Any, gain: Any) -> Floats:
    return np.asarray(response, float) / float(np.asarray(gain))


def _samples_until(least: float, share: Floats) -> int | None:
    """Number of samples after which the share is and stays at a value or above; None if it does not."""
    below = np.flatnonzero(~(share >= least))
    if not below.size:
        return 1
    return None if below[-1] == share.size - 1 else int(below[-1]) + 2
