"""Impulse response of a patient from a record of insulin and glucose: cross-correlation, or least squares.

The input has N samples u_0..u_(N-1) and the output N + 1 readings y_0..y_N, both as deviations from a steady state;
u_k is held from reading k to reading k + 1. Both estimates are JAX functions of the readings, so `jax.vmap` runs them
over noise realisations; values that aren't traced are computed with NumPy, where nothing is compiled, and what can be
refused is refused on them.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import NDArray

from glucoloop.arguments import is_traced
from glucoloop.identification import _check
from glucoloop.models.step_response import lagged_inputs
from glucoloop.refusal import Refusal


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
        raise Refusal("The insulin never leaves its steady rate, so it shows no response: use design_csrs.")
    past = lagged_inputs(insulin_deviation, memory)
    xp: Any = jnp if is_traced(past, glucose_deviation) else np
    insulin = xp.asarray(insulin_deviation, dtype=float)
    glucose = xp.asarray(glucose_deviation, dtype=float)
    return jnp.asarray(xp.asarray(past).T @ glucose / (insulin @ insulin))


def least_squares(
    insulin_deviation: ArrayLike,
    glucose_deviation: ArrayLike,
    memory: int,
    *,
    starts_at_rest: bool = True,
    free_baseline: bool = False,
    basis: ArrayLike | None = None,
    beside: ArrayLike | None = None,
) -> Array:
    """Finite impulse response that fits the readings best, for any persistently exciting input.

    ::

        minimise over h, g, b   sum_k (y_k - b - sum_{i=1..M} h_i u_(k-i) - sum_j g_j x_kj)^2

    Parameters
    ----------
    insulin_deviation, glucose_deviation, memory
        As for `cross_correlation`.
    starts_at_rest : bool
        Whether the input was zero before the record. If not, the first M readings, whose inputs are unknown,
        are left out.
    free_baseline : bool
        Whether a constant b is fitted along with h; otherwise it is 0.
    basis : array_like, shape (L, M), optional
        Rows in whose span h is sought, as from `laguerre_functions`; any h by default.
    beside : array_like, shape (N + 1, K), optional
        Further regressors x, fitted along with h: what else moves glucose, such as meals.

    Returns
    -------
    Array, shape (M,) or (M, R), or (L,) or (L, R) with a basis
        h_1..h_M, or the coefficients of the basis [mg/dl per mU/min].

    Raises
    ------
    ValueError
        If the shapes don't agree, a value isn't finite, the record is too short for as many coefficients, or the
        input doesn't excite them all.
    """
    memory = _check.whole_number("The memory", memory, 1)
    _check.input_and_readings(insulin_deviation, glucose_deviation)
    samples = np.shape(insulin_deviation)[0]
    past = lagged_inputs(insulin_deviation, memory)
    xp: Any = jnp if is_traced(past, glucose_deviation, basis, beside) else np
    others = xp.zeros((samples + 1, 0)) if beside is None else xp.asarray(beside, dtype=float)
    sought = memory if basis is None else np.shape(basis)[0]
    first = 0 if starts_at_rest else memory
    unknowns = sought + others.shape[1]
    # The first reading at steady state shows the baseline and nothing else.
    least = unknowns if starts_at_rest else memory + unknowns - 1 + free_baseline
    if samples < least:
        raise Refusal(
            f"A record of {samples} samples is too short for {unknowns} coefficients: "
            f"at least {least} samples are needed. Lengthen the record or shorten the memory."
        )

    regressors = xp.asarray(past)[first:]
    if basis is not None:
        regressors = regressors @ xp.asarray(basis, dtype=float).T
    readings = xp.asarray(glucose_deviation, dtype=float)[first:]
    whole = regressors
    if free_baseline:
        # A fitted constant is the same as the deviation of every column from its mean.
        others = others - others[first:].mean(axis=0)
        regressors, readings = regressors - regressors.mean(axis=0), readings - readings.mean(axis=0)
    if others.shape[1]:
        # What is fitted along with h is the same as what it leaves of every column (Frisch and Waugh, 1933).
        others = others[first:]
        regressors = regressors - others @ xp.linalg.lstsq(others, regressors)[0]
        readings = readings - others @ xp.linalg.lstsq(others, readings)[0]
    known = None if _check.concrete(insulin_deviation) is None else _check.concrete(regressors)
    if known is not None and (rank := _rank(known, float(xp.linalg.norm(whole)))) < sought:
        raise Refusal(
            f"The insulin record excites only {rank} of the {sought} coefficients asked for: shorten the memory, "
            "or use an input that changes more often (design_csrs, random_binary_sequence)."
        )
    return jnp.asarray(xp.linalg.lstsq(regressors, readings)[0])


def _rank(columns: NDArray[np.float64], size: float) -> int:
    """Rank of columns after a projection; parts below the rounding of their former norm `size` do not count."""
    left = np.linalg.svd(columns, compute_uv=False)
    return int(np.sum(left > max(columns.shape) * np.finfo(float).eps * size))


def from_rest(insulin: NDArray[np.float64], impulse_responses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Responses ``(N + 1, k)`` to insulin ``(N,)`` from steady state, of impulse responses ``(k, N)``."""
    from scipy.signal import fftconvolve  # half a second, which few commands need

    responses = np.zeros((insulin.size + 1, impulse_responses.shape[0]))
    responses[1:] = fftconvolve(insulin[None], impulse_responses, axes=1)[:, : insulin.size].T
    return responses
