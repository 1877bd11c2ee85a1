"""Impulse response of a patient from a record of insulin and glucose: cross-correlation, or least squares.

The input has N samples u_0..u_(N-1) and the output N + 1 readings y_0..y_N, both as deviations from a steady state;
u_k is held from reading k to reading k + 1. Both estimates are JAX functions of the readings, so `jax.vmap` runs them
over noise realisations; what can be refused is refused on values that aren't traced.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from glucoloop.identification import _check
from glucoloop.models.step_response import lagged_inputs


def cross_correlation(insulin_deviation: ArrayLike, glucose_deviation: ArrayLike, memory: int) -> Array:
    """First-order modified Wiener functional of a balanced, white input such as a CSRS.

    ::

        h_i = 1/(N A) sum_{k=i..N} y_k u_(k-i),    A = 1/N sum_k u_k^2,    i = 1..M

    For one pulse +a at sample 0 and one -a at sample M this is (y_i - y_(M+i))/(2 a). The estimate is exact for a
    patient of memory M when the input is white over the lags 1..M-1, rests for M samples before its end, and was at
    rest before the record; when it is balanced as well, a constant added to the readings doesn't change it.

    Parameters
    ----------
    insulin_deviation : array_like, shape (N,)
        Input [mU/min from the steady rate].
    glucose_deviation : array_like, shape (N + 1,) or (N + 1, R)
        Readings [mg/dl from the steady glucose], or a column for each of R realisations.
    memory : int
        M, the number of coefficients.

    Returns
    -------
    Array, shape (M,) or (M, R)
        h_1..h_M [mg/dl per mU/min].

    Raises
    ------
    ValueError
        If the shapes don't agree, a value isn't finite, or the input never leaves the steady rate.

    References
    ----------
    Parker, Doyle & Peppas 1999, eq. (9)-(11), after Lee & Schetzen, Int. J. Control 2(3), 237-254, 1965.
    """
    memory = _check.whole_number("The memory", memory, 1)
    _check.input_and_readings(insulin_deviation, glucose_deviation)
    known = _check.concrete(insulin_deviation)
    if known is not None and not known.any():
        raise ValueError("The insulin never leaves its steady rate, so it shows no response: use design_csrs.")
    insulin = jnp.asarray(insulin_deviation, dtype=float)
    glucose = jnp.asarray(glucose_deviation, dtype=float)
    return lagged_inputs(insulin, memory).T @ glucose / (insulin @ insulin)


def least_squares(
    insulin_deviation: ArrayLike,
    glucose_deviation: ArrayLike,
    memory: int,
    *,
    starts_at_rest: bool = True,
    free_baseline: bool = False,
) -> Array:
    """Finite impulse response that fits the readings best, for any persistently exciting input.

    ::

        minimise over h, b   sum_k (y_k - b - sum_{i=1..M} h_i u_(k-i))^2

    Parameters
    ----------
    insulin_deviation : array_like, shape (N,)
        Input [mU/min from the steady rate].
    glucose_deviation : array_like, shape (N + 1,) or (N + 1, R)
        Readings [mg/dl from the steady glucose], or a column for each of R realisations.
    memory : int
        M, the number of coefficients.
    starts_at_rest : bool
        Whether the input was zero before the record. If not, the first M readings, whose inputs are unknown,
        are left out.
    free_baseline : bool
        Whether a constant b is fitted along with h; otherwise it is 0.

    Returns
    -------
    Array, shape (M,) or (M, R)
        h_1..h_M [mg/dl per mU/min].

    Raises
    ------
    ValueError
        If the shapes don't agree, a value isn't finite, the record is too short for M coefficients, or the input
        doesn't excite them all.
    """
    memory = _check.whole_number("The memory", memory, 1)
    _check.input_and_readings(insulin_deviation, glucose_deviation)
    first = 0 if starts_at_rest else memory
    least = memory if starts_at_rest else 2 * memory - 1
    least += free_baseline and not starts_at_rest  # at rest, the first reading alone shows the baseline
    if np.shape(insulin_deviation)[0] < least:
        raise ValueError(
            f"A record of {np.shape(insulin_deviation)[0]} samples is too short for {memory} coefficients: "
            f"at least {least} samples are needed. Lengthen the record or shorten the memory."
        )

    regressors = lagged_inputs(insulin_deviation, memory)[first:]
    readings = jnp.asarray(glucose_deviation, dtype=float)[first:]
    if free_baseline:
        # A fitted constant is the same as the deviation of every column from its mean.
        regressors, readings = regressors - regressors.mean(axis=0), readings - readings.mean(axis=0)
    known = None if _check.concrete(insulin_deviation) is None else _check.concrete(regressors)
    if known is not None and (rank := int(np.linalg.matrix_rank(known))) < memory:
        raise ValueError(
            f"The insulin record excites only {rank} of the {memory} coefficients asked for: shorten the memory, "
            "or use an input that changes more often (design_csrs, random_binary_sequence)."
        )
    return jnp.linalg.lstsq(regressors, readings)[0]
