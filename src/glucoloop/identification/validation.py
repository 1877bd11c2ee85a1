"""Insulin tests: the sequence that reveals an impulse response, and a check of the model on another one.

Parker, Doyle & Peppas 1999, eq. (5), section III and Fig. 3. The paper's test is a special case of the constant-
switching-pace symmetric random sequence (CSRS): three levels, and pulses far enough apart for the response to each to
die out before the next.
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


def design_csrs(
    memory: int,
    amplitude_mU_min: float,
    samples: int | None = None,
    pulses: int | None = None,
    *,
    seed: int = 0,
) -> Array:
    """Pulses of +a and -a in equal numbers, at a constant pace of at least `memory` samples.

    The first pulse is at sample 0 and the last at least `memory` samples before the end. By default the record
    is the shortest there is: +a at sample 0, -a at sample M, 2 M samples.

    Parameters
    ----------
    memory : int
        M, the samples after which the patient's response to a pulse has died out.
    amplitude_mU_min : float
        a, at most the basal rate, since insulin cannot be taken back [mU/min].
    samples : int, optional
        Length N of the record. By default M for each pulse.
    pulses : int, optional
        Number of pulses, even. By default as many as fit.
    seed : int
        Decides the order of the signs when there is more than one pair; one pair is always +a, -a.

    Returns
    -------
    Array, shape (N,)
        Insulin deviation, held over each sample [mU/min].

    Raises
    ------
    ValueError
        If an argument is out of bounds, or the pulses don't fit in the record.
    """
    memory = _check.whole_number("The memory", memory, 1)
    amplitude = _check.positive("The amplitude", amplitude_mU_min, "mU/min")
    if pulses is None:
        length = 2 * memory if samples is None else _check.whole_number("The number of samples", samples, 1)
        pulses = 2 * max(1, length // (2 * memory))
    else:
        pulses = _check.whole_number("The number of pulses", pulses, 2)
        if pulses % 2:
            raise Refusal(f"{pulses} pulses are an odd number: +a and -a come in equal numbers, use {pulses + 1}.")
        length = pulses * memory if samples is None else _check.whole_number("The number of samples", samples, 1)
    if length < pulses * memory:
        raise Refusal(
            f"A record of {length} samples is too short: {pulses} pulses that are {memory} samples apart "
            f"need at least {pulses * memory} samples. Lengthen the record or shorten the memory."
        )

    signs = np.tile([1.0, -1.0], pulses // 2)
    if pulses > 2:
        signs = np.random.default_rng(seed).permutation(signs)
    insulin = np.zeros(length)
    insulin[np.arange(pulses) * (length // pulses)] = amplitude * signs
    return jnp.asarray(insulin)
