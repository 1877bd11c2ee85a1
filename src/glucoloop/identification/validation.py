"""Check of an identified model on data that it hasn't seen: a random binary sequence.

Parker, Doyle & Peppas 1999, section III and Fig. 3.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from glucoloop._pytree import pytree
from glucoloop.identification import _check
from glucoloop.models.step_response import StepResponseModel
from glucoloop.refusal import Refusal


@pytree
class Validation:
    """Comparison of a model's prediction from rest with the readings."""

    predicted_mg_dl: Array
    """Glucose deviation ``(N + 1,)`` of the model."""
    residuals_mg_dl: Array
    """Readings ``(N + 1,)`` minus prediction."""
    sum_absolute_residual_mg_dl: Array
    worst_residual_mg_dl: Array
    """Largest absolute residual."""
    fit_percent: Array
    """``100 (1 - |y - prediction| / |y - mean y|)``, 2-norms: 100 is perfect, 0 no better than the mean."""


def random_binary_sequence(samples: int, amplitude_mU_min: float, seed: int, *, hold_samples: int = 1) -> Array:
    """Insulin deviation of +a or -a, each equally likely, drawn again every `hold_samples` samples.

    It is ``(samples,)`` [mU/min], and the same for the same seed. A longer hold excites slow dynamics more. A
    ValueError refuses a length or an amplitude that is not above 0.
    """
    samples = _check.whole_number("The number of samples", samples, 1)
    hold = _check.whole_number("The hold", hold_samples, 1)
    amplitude = _check.positive("The amplitude", amplitude_mU_min, "mU/min")
    draws = np.random.default_rng(seed).integers(0, 2, -(-samples // hold))
    return jnp.asarray(amplitude * (2.0 * np.repeat(draws, hold)[:samples] - 1.0))


def validate(model: StepResponseModel, insulin_deviation: ArrayLike, glucose_deviation: ArrayLike) -> Validation:
    """Predict a record from its insulin alone, and compare with its readings.

    Parameters
    ----------
    model : StepResponseModel
        One model (step response of shape (M,)).
    insulin_deviation : array_like, shape (N,)
        Input [mU/min from the steady rate].
    glucose_deviation : array_like, shape (N + 1,)
        Readings, from the one at steady state to the end of the last sample [mg/dl from the steady glucose].

    Raises
    ------
    ValueError
        If the shapes don't agree, a value isn't finite, or the readings are all the same.
    """
    _check.input_and_readings(insulin_deviation, glucose_deviation)
    if np.ndim(glucose_deviation) != 1:
        raise Refusal(f"Readings of shape {np.shape(glucose_deviation)} are not one-dimensional: use jax.vmap.")
    known = _check.concrete(glucose_deviation)
    if known is not None and np.ptp(known) == 0:
        raise Refusal(
            f"All readings are {known[0]} mg/dl, so no fit can be computed: validate on an input that varies."
        )
    readings = jnp.asarray(glucose_deviation, dtype=float)
    predicted = model.predict(insulin_deviation)
    residuals = readings - predicted
    misfit = jnp.linalg.norm(residuals) / jnp.linalg.norm(readings - readings.mean())
    return Validation(
        predicted_mg_dl=predicted,
        residuals_mg_dl=residuals,
        sum_absolute_residual_mg_dl=jnp.abs(residuals).sum(),
        worst_residual_mg_dl=jnp.abs(residuals).max(),
        fit_percent=100 * (1 - misfit),
    )
