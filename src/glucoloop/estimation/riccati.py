"""Prediction covariance of a filter by the Riccati equation: the steady one, and one that follows the samples.

The steady covariance of a model that differs between people comes from the structured doubling algorithm. Where a model
is linearised again at every sample, the steady covariance of each linearisation is the gain's source. From one sample
to the next it changes little, so a few steps of the Riccati equation from that of the sample before come near it,
without a solve. It is kept as its lower triangle: symmetric as stored, and half as many numbers.

References
----------
B. D. O. Anderson and J. B. Moore, Optimal Filtering, Prentice-Hall, 1979, chapter 6.
E. K.-W. Chu, H.-Y. Fan, W.-W. Lin and C.-S. Wang, Structure-preserving algorithms for periodic discrete-time algebraic
Riccati equations, Int. J. Control 77(8), 2004, 767-788.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final, TypeAlias

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop.refusal import Refusal


def solved(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """Solution ``(n, m)`` of ``matrix x = right``, with a matrix ``(n, n)`` of full rank, by elimination.

    It can be differentiated in both directions, and mapped over people: on a processor of one after another. LAPACK's
    routines for many matrices at once can stop a program for ever: JAX 0.10 shares large batches out among the threads
    of XLA, and the thread that did so waits for the others. Where as many independent batches begin as there are
    threads, as in the doublings, all wait and none computes; on two threads this happens with two batches of 100
    triangular systems of 19 equations and 38 right sides each. A call for a single matrix is never shared out. Other
    devices solve for all people at once.
    """
    solution: jax.Array = jax.lax.custom_linear_solve(
        lambda x: matrix @ x,
        right,
        solve=lambda _, given: _eliminated(matrix, given),
        transpose_solve=lambda _, given: _eliminated(matrix.T, given),
    )
    return solution


def _with_rows_exchanged(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """Solution with the rows exchanged directly: `jnp.linalg.solve` transposes them twice."""
    factors, _, order = jax.lax.linalg.lu(matrix)
    below = jax.lax.linalg.triangular_solve(factors, right[order], left_side=True, lower=True, unit_diagonal=True)
    return jax.lax.linalg.triangular_solve(factors, below, left_side=True)


@functools.cache
def _elimination() -> Any:
    """Function `_with_rows_exchanged` with a rule for people."""
    eliminated = jax.custom_batching.custom_vmap(_with_rows_exchanged)
    eliminated.def_vmap(_of_people)
    return eliminated


def _eliminated(matrix: jax.Array, right: jax.Array) -> jax.Array:
    solution: jax.Array = _elimination()(matrix, right)
    return solution


def _of_people(size: int, mapped: list[bool], matrix: jax.Array, right: jax.Array) -> tuple[jax.Array, bool]:
    of_matrix, of_right = mapped

    def one_after_another(matrix: jax.Array, right: jax.Array) -> jax.Array:
        solutions: jax.Array
        if not of_right:
            solutions = jax.lax.map(lambda each: _eliminated(each, right), matrix)
        elif not of_matrix:
            solutions = jax.lax.map(lambda each: _eliminated(matrix, each), right)
        else:
            solutions = jax.lax.map(lambda each: _eliminated(*each), (matrix, right))
        return solutions

    def at_once(matrix: jax.Array, right: jax.Array) -> jax.Array:
        axes = tuple(0 if each else None for each in mapped)
        solutions: jax.Array = jax.vmap(_with_rows_exchanged, in_axes=axes)(matrix, right)
        return solutions

    return jax.lax.platform_dependent(matrix, right, cpu=one_after_another, default=at_once), True


def steady_state_covariance(
    Phi: jax.typing.ArrayLike,
    C: jax.typing.ArrayLike,
    Q: jax.typing.ArrayLike,
    R: jax.typing.ArrayLike,
    *,
    doublings: int = 10,
) -> jax.Array:
    """Steady prediction covariance by the structured doubling algorithm, traceable by JAX.

    Parameters
    ----------
    Phi, Q : (n, n) or (n, n, B)
        Transition matrix and covariance of the process noise.
    C : (n,) or (n, B)
        Output row.
    R : () or (B,)
        Variance of a reading, positive.
    doublings
        Largest number of doublings: `d` of them stand for 2^d steps of the Riccati equation from zero. With a
        closed-loop spectral radius rho the error is of the order of ``rho^(2^(d+1))``: 10 are exact for rho up to 0.98.

    Returns
    -------
    (n, n) or (n, n, B)
        The prediction covariance, symmetric; `filter_gain` makes the gain from it.

    Raises
    ------
    ValueError
        If `doublings` is less than 1.

    Notes
    -----
    Made for the designs of many people at once. Values are not validated here: for an undetectable model the result
    grows without bound, and `steady_state_gain` says why.

    Doublings end when more of them would change nothing. Let ``P_N`` be the covariance after N steps from zero. If
    ``P_2N - P_N <= e P_N`` (in the sense of definite matrices), then ``P - P_2N <= e^2 / (1 - e) P_N`` for the steady
    P, and after another doubling about ``e^4`` is left. The variances of the states are compared, with the fourth root
    of the machine epsilon for e, and one doubling follows.
    """
    if doublings < 1:
        raise Refusal(f"At least 1 doubling is needed, but {doublings} were asked for.")
    given = [(jnp.asarray(array), rank) for array, rank in ((Phi, 2), (C, 1), (Q, 2), (R, 0))]

    def of_one(Phi: jax.Array, C: jax.Array, Q: jax.Array, R: jax.Array) -> jax.Array:
        return _last_covariance(_doubled(Phi.T, C, Q, R, doublings - 1))

    if all(array.ndim == rank for array, rank in given):
        return of_one(*(array for array, _ in given))
    axes = tuple(-1 if array.ndim > rank else None for array, rank in given)
    return jax.vmap(of_one, in_axes=axes, out_axes=-1)(*(array for array, _ in given))


_Doubled: TypeAlias = "tuple[jax.Array, jax.Array, jax.Array]"
"""``Phi'`` of the closed loop, ``g`` and the covariance ``h``, after some number of steps."""


def _doubled(a: jax.Array, row: jax.Array, h: jax.Array, variance: jax.Array, doublings: int) -> _Doubled:
    """Result of up to 2^doublings steps from zero, where ``a`` is ``Phi'`` and ``h`` is Q.

    ``g`` begins as ``C' C / R``. While its rank is small it is kept as ``u s^-1 u'``, of which each doubling makes u
    twice as wide.
    """
    n = h.shape[0]
    eye = jnp.eye(n, dtype=a.dtype)
    u, s, done = row[:, None], variance[None, None], 0
    going = jnp.ones((), bool)
    while done < doublings and 2 * u.shape[1] <= n:
        seen = h @ u
        more = s + u.T @ seen
        ahead = a - u @ solved(more, seen.T @ a)
        u, s = jnp.concatenate([u, a @ u], axis=1), jax.scipy.linalg.block_diag(s, more)
        h, going = _grown(h, a.T @ h @ ahead)
        a, done = a @ ahead, done + 1
    g = u @ solved(s, u.T)

    def double(carry: _Doubled) -> tuple[_Doubled, jax.Array]:
        a, g, h = carry
        both = solved(eye + g @ h, jnp.concatenate([a, g], axis=1))
        ahead, gain = both[:, :n], both[:, n:]
        g = g + a @ gain @ a.T
        h, going = _grown(h, a.T @ h @ ahead)
        return (a @ ahead, 0.5 * (g + g.T), h), going

    def keep(carry: _Doubled) -> tuple[_Doubled, jax.Array]:
        return carry, jnp.zeros((), bool)

    def unless_done(_: int, state: tuple[_Doubled, jax.Array]) -> tuple[_Doubled, jax.Array]:
        carry, going = state
        further: tuple[_Doubled, jax.Array] = jax.lax.cond(going, double, keep, carry)
        return further

    doubled: _Doubled = jax.lax.fori_loop(0, doublings - done, unless_done, ((a, g, h), going))[0]
    return doubled


def _grown(h: jax.Array, more: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Covariance with what a doubling adds, and whether that was much; no if it is no number, so that time is saved."""
    total = h + more
    total = 0.5 * (total + total.T)
    much = jnp.finfo(h.dtype).eps ** 0.25
    every = h.shape[0] + 1
    return total, jnp.any(more.ravel()[::every] > much * total.ravel()[::every])


def _last_covariance(doubled: _Doubled) -> jax.Array:
    a, g, h = doubled
    h = h + a.T @ h @ solved(jnp.eye(h.shape[0], dtype=h.dtype) + g @ h, a)
    return 0.5 * (h + h.T)


RICCATI_STEPS: Final = 4
"""Steps of the Riccati equation at each sample."""


def triangle(P: jax.Array) -> jax.Array:
    """Lower triangle ``(n (n + 1) / 2,)`` of a covariance ``(n, n)``, row by row."""
    return P[np.tril_indices(P.shape[0])]


def whole(packed: jax.Array) -> jax.Array:
    """Covariance ``(n, n)`` of which the lower triangle is given."""
    n = _states(packed)
    row, column = np.maximum(*np.indices((n, n))), np.minimum(*np.indices((n, n)))
    return packed[row * (row + 1) // 2 + column]


def is_covariance(packed: jax.Array) -> jax.Array:
    """Whether all numbers are finite and no variance is negative."""
    row = np.arange(_states(packed))
    return jnp.all(jnp.isfinite(packed)) & jnp.all(packed[row * (row + 3) // 2] >= 0.0)


def _states(packed: jax.Array) -> int:
    return (math.isqrt(8 * packed.shape[0] + 1) - 1) // 2


def next_covariance(
    packed: jax.Array, Phi: jax.Array, C: jax.Array, Q: jax.Array, R: jax.Array | float, steps: int = RICCATI_STEPS
) -> jax.Array:
    """Prediction covariance some steps of the Riccati equation on, ``P <- Phi (P - P C' C P / (C P C' + R)) Phi' + Q``.

    Parameters
    ----------
    packed : (n (n + 1) / 2,)
        Lower triangle of the covariance of the sample before; the result is one too.
    Phi, C, Q : (n, n), (n,), (n, n)
        Transition matrix, row of the reading, and covariance of the process noise.
    R : ()
        Variance of a reading, positive.
    """

    def step(P: jax.Array, _: None) -> tuple[jax.Array, None]:
        seen = P @ C
        filtered = _mirrored(P - seen[:, None] * (seen / (C @ seen + R)))
        # The rows of insulin, which end in zeros, from the left: so fewer products are needed for the triangle.
        return _mirrored(Phi @ (Phi @ filtered).T + Q), None

    return triangle(jax.lax.scan(step, whole(packed), None, length=steps)[0])


def _mirrored(P: jax.Array) -> jax.Array:
    """The symmetric matrix with the lower triangle of another."""
    return jnp.tril(P) + jnp.tril(P, -1).T
