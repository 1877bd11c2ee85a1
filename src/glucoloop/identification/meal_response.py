"""Response of glucose to meals, fitted together with the response to insulin.

People take insulin when they eat. A fit that does not know of meals attributes the rise of glucose after them to that
insulin, and finds a gain that is too small or has the wrong sign.

The answer to a gram is a sum of Laguerre functions over six hours. Their pole is that of a time constant of 97.5 min,
.95 at samples of 5 min: slower than insulin's, since digestion takes hours. With it four functions leave no more of
the readings than six, on records of the patient of Sorensen (1985) under the meals of Lehmann and Deutsch (1992).
"""

from __future__ import annotations

import math
from typing import Final

import jax.numpy as jnp
import numpy as np
from jax import Array

from glucoloop.identification.laguerre import laguerre_functions
from glucoloop.identification.record import Record
from glucoloop.models.step_response import lagged_inputs

MEMORY_MIN: Final = 360.0
TIME_CONSTANT_MIN: Final = 97.5
FUNCTIONS: Final = 4


def meal_memory(sample_time_min: float) -> int:
    """Samples after which a meal has died out, at least 1."""
    return max(1, round(MEMORY_MIN / sample_time_min))


def meal_columns(record: Record) -> Array:
    """Regressors of the meals of a record, ``(N + 1, 4)`` at the usual sample times; ``(N + 1, 0)`` without meals."""
    if record.carbs_g is None or not np.any(np.asarray(record.carbs_g)):
        return jnp.asarray(np.zeros((np.shape(record.insulin_mU_min)[0] + 1, 0)))
    basis = _basis(record.sample_time_min)
    return lagged_inputs(record.carbs_g, basis.shape[1]) @ basis.T


def meal_impulse_response(coefficients: Array, sample_time_min: float) -> Array:
    """Rise of glucose 1, 2, .. samples after a gram [mg/dl per g]; empty if there are no coefficients."""
    if not coefficients.size:
        return jnp.zeros(0)
    return _basis(sample_time_min).T @ coefficients


def meal_answer(record: Record, impulse_response: Array) -> Array:
    """Contribution of the meals of a record to its readings, ``(N + 1,)`` [mg/dl]."""
    if record.carbs_g is None or not impulse_response.size:
        return jnp.zeros(np.shape(record.insulin_mU_min)[0] + 1)
    return lagged_inputs(record.carbs_g, impulse_response.size) @ impulse_response


def _basis(sample_time_min: float) -> Array:
    memory = meal_memory(sample_time_min)
    pole = math.exp(-sample_time_min / TIME_CONSTANT_MIN)
    return laguerre_functions(pole, min(FUNCTIONS, memory), memory)
