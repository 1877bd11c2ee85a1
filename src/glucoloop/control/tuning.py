"""The paper's tunings of linear MPC, and checks that designs share."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from jax.typing import ArrayLike

from glucoloop.arguments import ArgumentTypeError, is_traced
from glucoloop.control.settings import MPCTuning
from glucoloop.pumps.limits import DoseLimits
from glucoloop.refusal import Refusal


def check_sample_time(sample_time_min: float) -> None:
    """Refuse a sample time that is not positive and finite, or not known yet."""
    if is_traced(sample_time_min):
        raise ArgumentTypeError(
            "sample_time_min is traced by JAX, but it decides how many samples there are; give a plain number, "
            "or make it a static field: equinox.field(static=True)"
        )
    if not 0.0 < sample_time_min < math.inf:
        raise Refusal(f"a sample time of {sample_time_min:g} min is not possible; give a finite value above 0")


def check_rate(called: str, insulin_mU_min: float, limits: DoseLimits) -> None:
    """Refuse a constant rate that a pump cannot deliver; one that JAX traces passes."""
    if is_traced(insulin_mU_min, limits):
        return
    if not (math.isfinite(insulin_mU_min) and limits.min_mU_min <= insulin_mU_min <= limits.max_mU_min):
        raise Refusal(
            f"a {called} rate of {insulin_mU_min:g} mU/min is not possible; "
            f"give one from {limits.min_mU_min:g} to {limits.max_mU_min:g} mU/min"
        )


def check_gain(gain: ArrayLike) -> None:
    """Refuse a model in which insulin raises glucose, since its controller would give more insulin at low glucose.

    A gain that JAX traces has no value yet, and passes.
    """
    if not is_traced(gain) and not -math.inf < float(np.asarray(gain)) < 0.0:
        raise Refusal(
            f"a gain of {float(np.asarray(gain)):g} mg/dl per mU/min is not possible; insulin lowers glucose, so the "
            "gain of a model is below 0. Check the sign, or identify the model again from a record in which insulin "
            "changes more"
        )


NOISE_FREE: Final = MPCTuning(move_horizon=2, prediction_horizon=8, output_weight=1.0, move_weight=0.0)
"""Tuning of Sec. IV with the least sum of squared errors without noise."""
NOISY: Final = MPCTuning(move_horizon=2, prediction_horizon=10, output_weight=3.0, move_weight=1.0)
"""Tuning of Sec. IV for noise of variance 1.45."""
