"""Kalman filtering in filter form, for a model known at design and for one that changes at every sample.

    x(k+1) = Phi x(k) + Gamma u(k) + w(k),   w ~ N(0, Q)
    y(k)   = C x(k) + v(k),                  v ~ N(0, R)

The gain is that of the filter form, ``x(k|k) = x(k|k-1) + K (y(k) - C x(k|k-1))``; the predictor form's is ``Phi K``.

The functions that run at every sample (`predict`, `update`, `kalman_step`, `riccati_step`, `steady_state_covariance`,
`steady_state_seen`) have one output, so the innovation variance is a scalar and no matrix is inverted in the update;
several independent sensors are several updates. They serve one person and, with a trailing axis on any of their
arguments, a cohort.

References
----------
B. D. O. Anderson and J. B. Moore, Optimal Filtering, Prentice-Hall, 1979, chapters 3 and 4.
E. K.-W. Chu, H.-Y. Fan, W.-W. Lin and C.-S. Wang, Structure-preserving algorithms for periodic discrete-time algebraic
Riccati equations, Int. J. Control 77(8), 2004, 767-788 (the doubling algorithm).
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg  # type: ignore[import-untyped, unused-ignore]
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import NDArray

from glucoloop._pytree import pytree


@pytree
class SteadyStateFilter:
    """Answer of `steady_state_gain`.

    Attributes
    ----------
    gain : (n,) or (n, p)
        Filter-form gain K; a vector where `C` was one.
    prediction_covariance : (n, n)
        Covariance of ``x(k) - x(k|k-1)``.
    filtered_covariance : (n, n)
        Covariance of ``x(k) - x(k|k)``.
    innovation_covariance : () or (p, p)
        Covariance of ``y(k) - C x(k|k-1)``.
    """

    gain: Array
    prediction_covariance: Array
    filtered_covariance: Array
    innovation_covariance: Array


@pytree
class KalmanState:
    """An estimate and its uncertainty.

    Attributes
    ----------
    mean : (n,) or (n, B)
        Estimated state.
    covariance : (n, n) or (n, n, B)
        Covariance of its error.
    """

    mean: Array
    covariance: Array


@pytree
class Innovation:
    """Information that a reading gave the filter.

    Attributes
    ----------
    error : () or (B,)
        Reading less predicted output; zero where the reading was not valid.
    variance : () or (B,)
        Variance of the error, ``C P C' + R``.
    gain : (n,) or (n, B)
        Filter-form gain that was applied; zero where the reading was not valid.
    """

    error: Array
    variance: Array
    gain: Array


# Design ---------------------------------------------------------------------------------------------------------------


def steady_state_gain(Phi: ArrayLike, C: ArrayLike, Q: ArrayLike, R: ArrayLike) -> SteadyStateFilter:
    """Design the steady Kalman filter, in filter form.

    The prediction covariance is the stabilising solution of the Riccati equation

        P = Phi (P - P C' (C P C' + R)^-1 C P) Phi' + Q,    K = P C' (C P C' + R)^-1.

    Parameters
    ----------
    Phi : (n, n)
        Transition matrix.
    C : (n,) or (p, n)
        Output row, or rows.
    Q : (n, n)
        Covariance of the process noise, symmetric and positive semi-definite.
    R : () or (p, p)
        Covariance of the measurement noise, symmetric and positive definite; a scalar counts for every output.

    Returns
    -------
    SteadyStateFilter

    Raises
    ------
    ValueError
        If an argument is not finite, has the wrong shape, is not symmetric or not (semi-)definite, or if there is no
        stabilising solution: a mode that is not stable is not seen by `C`, or one on the unit circle is not driven by
        `Q`.

    Examples
    --------
    >>> design = steady_state_gain([[1.0]], [1.0], [[1.0]], 1.0)
    >>> round(float(design.gain[0]), 12)  # the golden ratio
    0.61803398875
    """
    Phi, C, Q, R = (_finite_array(name, a) for name, a in (("Phi", Phi), ("C", C), ("Q", Q), ("R", R)))
    if Phi.ndim != 2 or Phi.shape[0] != Phi.shape[1]:
        raise ValueError(f"Phi must be square, but its shape is {Phi.shape}.")
    n = Phi.shape[0]
    single = C.ndim == 1
    rows = C[None] if single else C
    if rows.ndim != 2 or rows.shape[1] != n:
        raise ValueError(f"C must be ({n},) or (p, {n}) to go with Phi, but its shape is {C.shape}.")
    p = rows.shape[0]
    if Q.shape != (n, n):
        raise ValueError(f"Q must be ({n}, {n}) to go with Phi, but its shape is {Q.shape}.")
    noise = R * np.eye(p) if R.ndim == 0 else R
    if noise.shape != (p, p):
        raise ValueError(f"R must be a scalar or ({p}, {p}) to go with C, but its shape is {R.shape}.")
    _symmetric("Q", Q)
    _symmetric("R", noise)
    smallest = float(np.linalg.eigvalsh(Q)[0])
    if smallest < -1e-12 * max(1.0, float(np.abs(Q).max())):
        raise ValueError(f"Q must be positive semi-definite, but its smallest eigenvalue is {smallest:.3g}.")
    smallest = float(np.linalg.eigvalsh(noise)[0])
    if smallest <= 0.0:
        raise ValueError(f"R must be positive definite, but its smallest eigenvalue is {smallest:.3g}.")

    refusal = (
        "The Riccati equation has no stabilising solution: every mode of Phi that is not stable must be seen by C "
        "(detectability), and every mode on the unit circle must be driven by Q."
    )
    try:
        P = scipy.linalg.solve_discrete_are(Phi.T, rows.T, Q, noise)
    except np.linalg.LinAlgError as error:
        raise ValueError(refusal) from error
    P = 0.5 * (P + P.T)
    S = rows @ P @ rows.T + noise
    gain = np.linalg.solve(S, rows @ P).T
    keep = np.eye(n) - gain @ rows
    filtered = keep @ P @ keep.T + gain @ noise @ gain.T
    residual = float(np.abs(Phi @ filtered @ Phi.T + Q - P).max())
    radius = float(np.abs(np.linalg.eigvals(keep @ Phi)).max())
    if not (np.isfinite(P).all() and radius < 1.0 - 1e-9):
        raise ValueError(f"{refusal} Spectral radius of (I - K C) Phi: {radius:.6g}.")
    if residual > 1e-7 * float(np.abs(P).max()):
        raise ValueError(
            f"The Riccati equation is too badly scaled to be solved: its residual is {residual:.3g} beside a "
            f"covariance of {np.abs(P).max():.3g}. Scale the states, or bring Q and R closer together."
        )
    return SteadyStateFilter(
        gain=jnp.asarray(gain[:, 0] if single else gain),
        prediction_covariance=jnp.asarray(P),
        filtered_covariance=jnp.asarray(0.5 * (filtered + filtered.T)),
        innovation_covariance=jnp.asarray(S[0, 0] if single else S),
    )


def _finite_array(name: str, value: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(value, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, but it holds {array[~np.isfinite(array)].ravel()[0]}.")
    return array


def _symmetric(name: str, matrix: NDArray[np.float64]) -> None:
    skew = float(np.abs(matrix - matrix.T).max())
    if skew > 1e-10 * max(float(np.abs(matrix).max()), 1e-300):
        raise ValueError(f"{name} must be symmetric, but it differs from its transpose by {skew:.3g}.")


# At every sample ------------------------------------------------------------------------------------------------------


def _matvec(A: Array, x: Array) -> Array:
    return jnp.einsum("ij...,j...->i...", A, x)


def _propagate(Phi: Array, P: Array, Q: Array) -> Array:
    """``Phi P Phi' + Q``, symmetric to the last bit."""
    half = jnp.einsum("ij...,jk...->ik...", Phi, P)
    full = jnp.einsum("ik...,jk...->ij...", half, Phi)
    return 0.5 * (full + jnp.swapaxes(full, 0, 1)) + _people(Q, full)


def _people(a: Array, like: Array) -> Array:
    """Give an array without people the people axis of another."""
    return a[..., None] if a.ndim < like.ndim else a


def _correct(P: Array, C: Array, R: Array) -> tuple[Array, Array, Array]:
    """Covariance after a reading, the gain, and the innovation variance."""
    seen = jnp.einsum("ij...,j...->i...", P, C)
    variance = jnp.einsum("i...,i...->...", _people(C, seen), seen) + R
    gain = seen / variance
    # Joseph's form, (I - K C) P (I - K C)' + K R K', by rank-one steps: it stays positive semi-definite where the short
    # form P - K C P loses that to rounding (an exact reading of an uncertain state), at the same order of cost.
    left = _people(P, gain[None]) - gain[:, None] * seen[None, :]
    right = left - jnp.einsum("ij...,j...->i...", left, C)[:, None] * gain[None, :]
    joseph = right + gain[:, None] * gain[None, :] * R
    return 0.5 * (joseph + jnp.swapaxes(joseph, 0, 1)), gain, variance


def predict(state: KalmanState, Phi: ArrayLike, Q: ArrayLike, forcing: ArrayLike = 0.0) -> KalmanState:
    """Carry an estimate over one sample: ``Phi x + forcing`` and ``Phi P Phi' + Q``.

    Parameters
    ----------
    state
        Estimate at sample k.
    Phi : (n, n) or (n, n, B)
        Transition matrix.
    Q : (n, n) or (n, n, B)
        Covariance of the process noise.
    forcing : (n,), (n, B) or scalar
        Contribution of the known inputs, ``Gamma u``.

    Returns
    -------
    KalmanState
        Prediction for sample k + 1.
    """
    Phi, Q = jnp.asarray(Phi), jnp.asarray(Q)
    mean = _matvec(Phi, state.mean)
    added = jnp.asarray(forcing)
    if 0 < added.ndim < mean.ndim:
        added = added[:, None]
    elif mean.ndim < added.ndim:
        mean = mean[:, None]
    return KalmanState(mean=mean + added, covariance=_propagate(Phi, state.covariance, Q))


def update(
    state: KalmanState, reading: ArrayLike, C: ArrayLike, R: ArrayLike, valid: ArrayLike = True
) -> tuple[KalmanState, Innovation]:
    """Correct a prediction by a reading.

    Parameters
    ----------
    state
        Prediction.
    reading : () or (B,)
        Measured output.
    C : (n,) or (n, B)
        Output row.
    R : () or (B,)
        Variance of the reading, positive.
    valid : () or (B,) bool
        Whether there is a reading; where there is none, or it is not finite, the prediction stands.

    Returns
    -------
    KalmanState
        The corrected estimate.
    Innovation
        The error of the prediction, its variance, and the gain.
    """
    C, R, reading = jnp.asarray(C), jnp.asarray(R), jnp.asarray(reading)
    covariance, gain, variance = _correct(state.covariance, C, R)
    usable = jnp.asarray(valid) & jnp.isfinite(reading)
    predicted = jnp.einsum("i...,i...->...", C, state.mean)
    error = jnp.where(usable, reading - predicted, 0.0)
    gain = jnp.where(usable, _people(gain, error[None]), 0.0)
    before = state.mean if state.mean.ndim == gain.ndim else _people(state.mean, gain)
    uncertain = _people(state.covariance, gain[None])
    corrected = KalmanState(
        mean=before + gain * error,
        covariance=jnp.where(usable, _people(covariance, gain[None]), uncertain),
    )
    return corrected, Innovation(error=error, variance=variance, gain=gain)


def kalman_step(
    state: KalmanState,
    reading: ArrayLike,
    Phi: ArrayLike,
    C: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    *,
    forcing: ArrayLike = 0.0,
    valid: ArrayLike = True,
) -> tuple[KalmanState, Innovation]:
    """One sample of the time-varying filter: `predict` with the input applied since the last reading, then `update`.

    Parameters
    ----------
    state
        Estimate x(k-1|k-1).
    reading : () or (B,)
        y(k).
    Phi, C, Q, R
        The model between samples k-1 and k, and at k; see `predict` and `update`.
    forcing : (n,), (n, B) or scalar
        ``Gamma u(k-1)``.
    valid : () or (B,) bool
        Whether there is a reading.

    Returns
    -------
    KalmanState
        Estimate x(k|k).
    Innovation
        Innovation of the reading.
    """
    return update(predict(state, Phi, Q, forcing), reading, C, R, valid)


def riccati_step(P: ArrayLike, Phi: ArrayLike, C: ArrayLike, Q: ArrayLike, R: ArrayLike) -> Array:
    """Prediction covariance one sample on: ``Phi (P - P C' (C P C' + R)^-1 C P) Phi' + Q``.

    Parameters
    ----------
    P, Phi, Q : (n, n) or (n, n, B)
        Prediction covariance, transition matrix, covariance of the process noise.
    C : (n,) or (n, B)
        Output row.
    R : () or (B,)
        Variance of a reading, positive.

    Returns
    -------
    (n, n) or (n, n, B)
        The next prediction covariance, symmetric.
    """
    filtered, _, _ = _correct(jnp.asarray(P), jnp.asarray(C), jnp.asarray(R))
    return _propagate(jnp.asarray(Phi), filtered, jnp.asarray(Q))


def filter_gain(P: ArrayLike, C: ArrayLike, R: ArrayLike) -> Array:
    """Filter-form gain ``P C' / (C P C' + R)`` that belongs to a prediction covariance.

    Parameters
    ----------
    P : (n, n) or (n, n, B)
        Prediction covariance.
    C : (n,) or (n, B)
        Output row.
    R : () or (B,)
        Variance of a reading, positive.

    Returns
    -------
    (n,) or (n, B)
        The gain.
    """
    C = jnp.asarray(C)
    seen = jnp.einsum("ij...,j...->i...", jnp.asarray(P), C)
    return seen / (jnp.einsum("i...,i...->...", _people(C, seen), seen) + jnp.asarray(R))


def steady_state_covariance(Phi: ArrayLike, C: ArrayLike, Q: ArrayLike, R: ArrayLike, *, doublings: int = 10) -> Array:
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
    Made for a controller that linearises again at every sample. It carries no state from sample to sample, so nothing
    can drift, and it needs no warm start. Values are not validated here: for an undetectable model the result grows
    without bound, and `steady_state_gain` says why.

    Doublings end when more of them would change nothing. Let ``P_N`` be the covariance after N steps from zero. If
    ``P_2N - P_N <= e P_N`` (in the sense of definite matrices), then ``P - P_2N <= e^2 / (1 - e) P_N`` for the steady
    P, and after another doubling about ``e^4`` is left. The variances of the states are compared, with the fourth root
    of the machine epsilon for e, and one doubling follows.
    """
    return _steady(_last_covariance, Phi, C, Q, R, doublings)


def steady_state_seen(Phi: ArrayLike, C: ArrayLike, Q: ArrayLike, R: ArrayLike, *, doublings: int = 10) -> Array:
    """Product ``P C'`` of the steady prediction covariance, which is all that a gain needs.

    The parameters are those of `steady_state_covariance`. The filter-form gain is ``P C' / (C P C' + R)``.

    Returns
    -------
    (n,) or (n, B)
        Covariance of the error of each state with that of the predicted output.

    Raises
    ------
    ValueError
        If `doublings` is less than 1.
    """
    return _steady(_last_seen, Phi, C, Q, R, doublings)


_Doubled = tuple[Array, Array, Array]
"""``Phi'`` of the closed loop, ``g`` and the covariance ``h``, after some number of steps."""


def _steady(
    last: Callable[[_Doubled, Array], Array], Phi: ArrayLike, C: ArrayLike, Q: ArrayLike, R: ArrayLike, doublings: int
) -> Array:
    """Result of the last doubling, of one person or, with a trailing axis on any of the arguments, of a cohort."""
    if doublings < 1:
        raise ValueError(f"At least 1 doubling is needed, but {doublings} were asked for.")
    given = [(jnp.asarray(array), rank) for array, rank in ((Phi, 2), (C, 1), (Q, 2), (R, 0))]

    def of_one(Phi: Array, C: Array, Q: Array, R: Array) -> Array:
        return last(_doubled(Phi.T, C, Q, R, doublings - 1), C)

    if all(array.ndim == rank for array, rank in given):
        return of_one(*(array for array, _ in given))
    axes = tuple(-1 if array.ndim > rank else None for array, rank in given)
    return jax.vmap(of_one, in_axes=axes, out_axes=-1)(*(array for array, _ in given))


def _doubled(a: Array, row: Array, h: Array, variance: Array, doublings: int) -> _Doubled:
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
        ahead = a - u @ _solved(more, seen.T @ a)
        u, s = jnp.concatenate([u, a @ u], axis=1), jax.scipy.linalg.block_diag(s, more)
        h, going = _grown(h, a.T @ h @ ahead)
        a, done = a @ ahead, done + 1
    g = u @ _solved(s, u.T)

    def double(carry: _Doubled) -> tuple[_Doubled, Array]:
        a, g, h = carry
        both = _solved(eye + g @ h, jnp.concatenate([a, g], axis=1))
        ahead, gain = both[:, :n], both[:, n:]
        g = g + a @ gain @ a.T
        h, going = _grown(h, a.T @ h @ ahead)
        return (a @ ahead, 0.5 * (g + g.T), h), going

    def keep(carry: _Doubled) -> tuple[_Doubled, Array]:
        return carry, jnp.zeros((), bool)

    def unless_done(_: int, state: tuple[_Doubled, Array]) -> tuple[_Doubled, Array]:
        carry, going = state
        further: tuple[_Doubled, Array] = jax.lax.cond(going, double, keep, carry)
        return further

    doubled: _Doubled = jax.lax.fori_loop(0, doublings - done, unless_done, ((a, g, h), going))[0]
    return doubled


def _grown(h: Array, more: Array) -> tuple[Array, Array]:
    """Covariance with what a doubling adds, and whether that was much; no if it is no number, so that time is saved."""
    total = h + more
    total = 0.5 * (total + total.T)
    much = jnp.finfo(h.dtype).eps ** 0.25
    every = h.shape[0] + 1
    return total, jnp.any(more.ravel()[::every] > much * total.ravel()[::every])


def _last_covariance(doubled: _Doubled, C: Array) -> Array:
    del C
    a, g, h = doubled
    h = h + a.T @ h @ _solved(jnp.eye(h.shape[0], dtype=h.dtype) + g @ h, a)
    return 0.5 * (h + h.T)


def _last_seen(doubled: _Doubled, C: Array) -> Array:
    a, g, h = doubled
    ahead = _solved(jnp.eye(h.shape[0], dtype=h.dtype) + g @ h, (a @ C)[:, None])[:, 0]
    return h @ C + a.T @ (h @ ahead)


def _solved(matrix: Array, right: Array) -> Array:
    """Solution of linear equations, with the rows exchanged directly: `jnp.linalg.solve` transposes them twice."""
    factors, _, order = jax.lax.linalg.lu(matrix)
    below = jax.lax.linalg.triangular_solve(factors, right[order], left_side=True, lower=True, unit_diagonal=True)
    return jax.lax.linalg.triangular_solve(factors, below, left_side=True)
