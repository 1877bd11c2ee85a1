"""Tuning of the predictive controllers, in the paper's notation (m, p, Gamma_y, Gamma_u)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from jax.typing import ArrayLike

from glucoloop.arguments import ArgumentTypeError, checked, is_traced

LONGEST_MOVE_HORIZON: Final = 50
LONGEST_PREDICTION_HORIZON: Final = 288


def check_sample_time(sample_time_min: float) -> None:
    """Refuse a sample time that is not positive and finite, or not known yet."""
    if is_traced(sample_time_min):
        raise ArgumentTypeError(
            "sample_time_min is traced by JAX, but it decides how many samples there are; give a plain number, "
            "or make it a static field: equinox.field(static=True)"
        )
    if not 0.0 < sample_time_min < math.inf:
        raise ValueError(f"a sample time of {sample_time_min:g} min is not possible; give a finite value above 0")


def check_gain(gain: ArrayLike) -> None:
    """Refuse a model in which insulin raises glucose: a controller designed on it would give more insulin to a low.

    A gain that JAX traces has no value yet, and passes.
    """
    if not is_traced(gain) and not -math.inf < float(np.asarray(gain)) < 0.0:
        raise ValueError(
            f"a gain of {float(np.asarray(gain)):g} mg/dl per mU/min is not possible; insulin lowers glucose, so the "
            "gain of a model is below 0. Check the sign, or identify the model again from a record in which insulin "
            "changes more"
        )


@checked
@dataclass(frozen=True)
class MPCTuning:
    """Horizons and weights of a predictive controller.

    Parameters
    ----------
    move_horizon : int
        Moves m that the controller plans, at least 1.
    prediction_horizon : int
        Samples p that it looks ahead, at least m.
    output_weight : float
        Gamma_y on the error of glucose, above 0.
    move_weight : float
        Gamma_u on each move, 0 or more.

    Raises
    ------
    ValueError
        Outside these bounds.
    """

    move_horizon: int = 2
    prediction_horizon: int = 8
    output_weight: float = 1.0
    move_weight: float = 0.0

    def __post_init__(self) -> None:
        if not 1 <= self.move_horizon <= LONGEST_MOVE_HORIZON:
            raise ValueError(
                f"a move horizon of {self.move_horizon} is not possible; "
                f"give a whole number from 1 to {LONGEST_MOVE_HORIZON}"
            )
        if not self.move_horizon <= self.prediction_horizon <= LONGEST_PREDICTION_HORIZON:
            raise ValueError(
                f"a prediction horizon of {self.prediction_horizon} is not possible with a move horizon of "
                f"{self.move_horizon}; give a whole number from {self.move_horizon} to {LONGEST_PREDICTION_HORIZON}"
            )
        if not is_traced(self.output_weight) and not 0.0 < self.output_weight < math.inf:
            raise ValueError(f"an output weight of {self.output_weight:g} is not possible; give a finite value above 0")
        if not is_traced(self.move_weight) and not 0.0 <= self.move_weight < math.inf:
            raise ValueError(f"a move weight of {self.move_weight:g} is not possible; give a finite value of 0 or more")


@checked
@dataclass(frozen=True)
class StateTuning(MPCTuning):
    """Tuning of the controllers that estimate the state: the horizons and weights, and a reference filter.

    Parameters
    ----------
    reference_filter : float
        phi_r, at least 0 and below 1. The reference goes from the estimated glucose to the setpoint as ``phi_r^(i-s)``
        for the sample i ahead; 0 asks for the setpoint at once.
    reference_start : int
        s, 0 or 1: whether the reference starts to move at this sample or at the next.
    """

    reference_filter: float = 0.65
    reference_start: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_traced(self.reference_filter) and not 0.0 <= self.reference_filter < 1.0:
            raise ValueError(
                f"a reference filter of {self.reference_filter:g} is not possible; give 0 or more and less than 1"
            )
        if self.reference_start not in (0, 1):
            raise ValueError(f"a reference start of {self.reference_start} is not possible; give 0 or 1")

    def reference(self) -> npt.NDArray[np.float64]:
        """``phi_r^(i-s)`` for i = 1 .. p."""
        ahead = np.arange(1, self.prediction_horizon + 1) - self.reference_start
        return np.asarray(self.reference_filter**ahead, np.float64)


NOISE_FREE: Final = MPCTuning(move_horizon=2, prediction_horizon=8, output_weight=1.0, move_weight=0.0)
"""Sec. IV: the least sum of squared errors without noise."""
NOISY: Final = MPCTuning(move_horizon=2, prediction_horizon=10, output_weight=3.0, move_weight=1.0)
"""Sec. IV: detuned for noise of variance 1.45."""
