"""Discrete Laguerre functions: a smooth, decaying basis for a noisy impulse response.

Parker, Doyle & Peppas 1999, eq. (12)-(14); state form as in L. Wang, Model Predictive Control System Design and
Implementation Using MATLAB, Springer 2009, section 3.2.
"""

from __future__ import annotations

import math
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from glucoloop._kept_programs import kept_jit
from glucoloop._pytree import pytree
from glucoloop.arguments import is_traced
from glucoloop.identification import _check
from glucoloop.models.step_response import Realisation
from glucoloop.refusal import Refusal

MIN_TAIL: Final = 0.05
"""Share of the sum of a Laguerre function that must come after the memory for a response to go on after it."""


@pytree
class PoleSearch:
    """Residual error of a Laguerre projection at P poles: the 2-norm of h minus its projection [mg/dl per mU/min]."""

    pole: Array
    """Pole with the smallest residual error."""
    residual_norm: Array
    """Residual error at that pole."""
    poles: Array
    """Grid of poles ``(P,)``."""
    residual_norms: Array
    """Residual error ``(P,)`` at each pole of the grid."""


def laguerre_functions(pole: float | Array, functions: int, memory: int) -> Array:
    """The first L Laguerre functions over M samples.

    ::

        X(0) = sqrt(1 - a^2) [1, -a, a^2, ...],    X(j+1) = A X(j)
        A_mm = a,    A_mi = (-a)^(m-i-1) (1 - a^2) for i < m

    They are orthonormal over an infinite memory, and nearly so once a^M is small.

    Parameters
    ----------
    pole : float
        a, the rate of decay, between 0 and 1.
    functions : int
        L, from 1 to M.
    memory : int
        M, the number of samples.

    Returns
    -------
    Array, shape (L, M)
        Row m is l_m; column j meets the coefficient h_(j+1).

    Raises
    ------
    ValueError
        If the pole isn't strictly between 0 and 1, or L isn't within 1..M.
    """
    memory = _check.whole_number("The memory", memory, 1)
    functions = _check.whole_number("The number of Laguerre functions", functions, 1)
    if functions > memory:
        raise Refusal(
            f"{functions} Laguerre functions are more than the {memory} coefficients they describe: "
            f"use at most {memory}."
        )
    known = _check.concrete(pole)
    if known is not None and not (0 < known < 1):
        raise Refusal(
            f"A Laguerre pole of {pole} is not strictly between 0 and 1: use exp(-T/tau) for a decay with "
            "time constant tau, about .84 for the diabetic patient."
        )
    rows: Array = _functions(jnp.asarray(pole, dtype=float), functions, memory)
    return rows


def laguerre_coefficients(impulse_response: ArrayLike, pole: float | Array, functions: int) -> Array:
    """Least-squares coefficients c of h_i = sum_m c_m l_m(i - 1).

    Parameters
    ----------
    impulse_response : array_like, shape (M,) or (M, R)
        h_1..h_M [mg/dl per mU/min].
    pole : float
        a, between 0 and 1.
    functions : int
        L, from 1 to M.

    Returns
    -------
    Array, shape (L,) or (L, R)
        c_1..c_L [mg/dl per mU/min].

    Raises
    ------
    ValueError
        If the response isn't finite, the pole isn't strictly between 0 and 1, or L isn't within 1..M.
    """
    basis = laguerre_functions(pole, functions, _memory(impulse_response))
    return _fit(basis, jnp.asarray(impulse_response, dtype=float))


def laguerre_smooth(impulse_response: ArrayLike, pole: float | Array, functions: int) -> Array:
    """Projection of an impulse response on the first L Laguerre functions, of the shape of the response.

    Arguments and errors are those of `laguerre_coefficients`.
    """
    basis = laguerre_functions(pole, functions, _memory(impulse_response))
    return basis.T @ _fit(basis, jnp.asarray(impulse_response, dtype=float))


def laguerre_sum(pole: float) -> float:
    """Sum of each Laguerre function over all time, ``sqrt((1 + a) / (1 - a))``, the same for all of them."""
    return math.sqrt((1.0 + pole) / (1.0 - pole))


def laguerre_realisation(coefficients: ArrayLike, pole: float, memory: int) -> Realisation | None:
    """Realisation of a smoothed impulse response: the Laguerre network that generates its functions, without end.

    Coefficients ``(L,)`` or ``(L, R)`` were fitted over `memory` samples. The realisation is of all coefficients, those
    of the memory included; None if each function has died out, with less than `MIN_TAIL` of its sum after the memory.
    """
    c, over_all_time = np.asarray(coefficients, dtype=float), laguerre_sum(pole)
    later = over_all_time - np.asarray(laguerre_functions(pole, c.shape[0], memory)).sum(axis=1)
    if np.all(np.abs(later) < MIN_TAIL * over_all_time):
        return None
    transition, start = _network(jnp.asarray(pole, dtype=float), c.shape[0])
    return Realisation(transition=transition, start=start, output=jnp.asarray(c))


def best_pole(impulse_response: ArrayLike, functions: int, grid: ArrayLike | None = None) -> PoleSearch:
    """Search a grid for the pole whose Laguerre projection leaves the smallest residual error.

    Parameters
    ----------
    impulse_response : array_like, shape (M,)
        h_1..h_M [mg/dl per mU/min].
    functions : int
        L, from 1 to M.
    grid : array_like, shape (P,), optional
        Poles to try. By default .01, .02, ..., .99.

    Raises
    ------
    ValueError
        If the response isn't one-dimensional or finite, the grid is empty or leaves (0, 1), or L isn't within 1..M.
    """
    memory = _memory(impulse_response)
    if np.ndim(impulse_response) != 1:
        raise Refusal(
            f"An impulse response of shape {np.shape(impulse_response)} is not one-dimensional: "
            "use jax.vmap for several responses."
        )
    candidates = np.arange(1, 100) / 100 if grid is None else np.atleast_1d(np.asarray(grid, dtype=float))
    if candidates.size == 0:
        raise Refusal("The grid of Laguerre poles is empty: give at least one pole between 0 and 1.")
    for pole in candidates[~((candidates > 0) & (candidates < 1))]:
        laguerre_functions(float(pole), functions, memory)
    response = jnp.asarray(impulse_response, dtype=float)

    def residual_norm(pole: Array) -> Array:
        basis = laguerre_functions(pole, functions, memory)
        left = response - basis.T @ _fit(basis, response)
        return jnp.sqrt(left @ left)

    poles = jnp.asarray(candidates)
    errors = jax.vmap(residual_norm)(poles)
    best = jnp.argmin(errors)
    return PoleSearch(pole=poles[best], residual_norm=errors[best], poles=poles, residual_norms=errors)


@kept_jit(static_argnums=(1, 2))
def _functions(pole: Array, functions: int, memory: int) -> Array:
    transition, start = _network(pole, functions)
    states = jax.lax.scan(lambda x, _: (transition @ x, x), start, length=memory)[1]
    return jnp.transpose(states)


def _network(pole: Array, functions: int) -> tuple[Array, Array]:
    """A and X(0)."""
    order = jnp.arange(functions)
    lag = order[:, None] - order[None, :]
    below = (-pole) ** jnp.maximum(lag - 1, 0) * (1 - pole**2)
    transition = jnp.where(lag == 0, pole, jnp.where(lag > 0, below, 0.0))
    return transition, (-pole) ** order * jnp.sqrt(1 - pole**2)


def _fit(basis: Array, response: Array) -> Array:
    # Over a finite memory the functions aren't quite orthonormal, hence least squares and not inner products.
    xp: Any = jnp if is_traced(basis, response) else np
    return jnp.asarray(xp.linalg.lstsq(xp.asarray(basis).T, xp.asarray(response))[0])


def _memory(impulse_response: ArrayLike) -> int:
    shape = np.shape(impulse_response)
    if not shape or shape[0] == 0:
        raise Refusal(f"An impulse response of shape {shape} has no coefficient: give h_1..h_M, at least one.")
    _check.finite(
        "The impulse-response coefficients", impulse_response, "identify it again without the missing readings"
    )
    return int(shape[0])
