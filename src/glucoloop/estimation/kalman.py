"""Kalman filtering in filter form, for a model known at design and for one that changes at every sample.

    x(k+1) = Phi x(k) + Gamma u(k) + w(k),   w ~ N(0, Q)
    y(k)   = C x(k) + v(k),                  v ~ N(0, R)

The gain is that of the filter form, ``x(k|k) = x(k|k-1) + K (y(k) - C x(k|k-1))``; the predictor form's is ``Phi K``.

The functions that run at every sample (`predict`, `update`, `kalman_step`, `riccati_step`) have one output, so the
innovation variance is a scalar and no matrix is inverted in the update; several independent sensors are several
updates. They serve one person and, with a trailing axis on any of their arguments, a cohort.

Reference: B. D. O. Anderson and J. B. Moore, Optimal Filtering, Prentice-Hall, 1979, chapters 3 and 4.
"""

from __future__ import annotations

from glucoloop._lazy_jax import jax, jnp, np, npt, scipy
from glucoloop._pytree import pytree
from glucoloop.refusal import Refusal


@pytree
class SteadyStateFilter:
    """Answer of `steady_state_gain`."""

    gain: jax.Array
    """Filter-form gain K; a vector where `C` was one. Shape ``(n,)`` or ``(n, p)``."""
    prediction_covariance: jax.Array
    """Covariance of ``x(k) - x(k|k-1)``, ``(n, n)``."""
    filtered_covariance: jax.Array
    """Covariance of ``x(k) - x(k|k)``, ``(n, n)``."""
    innovation_covariance: jax.Array
    """Covariance of ``y(k) - C x(k|k-1)``, ``()`` or ``(p, p)``."""


@pytree
class KalmanState:
    """An estimate and its uncertainty."""

    mean: jax.Array
    """Estimated state, ``(n,)`` or ``(n, B)``."""
    covariance: jax.Array
    """Covariance of its error, ``(n, n)`` or ``(n, n, B)``."""


@pytree
class Innovation:
    """Information that a reading gave the filter."""

    error: jax.Array
    """Reading less predicted output; zero where the reading was not valid."""
    variance: jax.Array
    """Variance of the error, ``C P C' + R``."""
    gain: jax.Array
    """Filter-form gain that was applied; zero where the reading was not valid. Shape ``(n,)`` or ``(n, B)``."""


# Design ---------------------------------------------------------------------------------------------------------------


def steady_state_gain(
    Phi: jax.typing.ArrayLike, C: jax.typing.ArrayLike, Q: jax.typing.ArrayLike, R: jax.typing.ArrayLike
) -> SteadyStateFilter:
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
        raise Refusal(f"Phi must be square, but its shape is {Phi.shape}.")
    n = Phi.shape[0]
    single = C.ndim == 1
    rows = C[None] if single else C
    if rows.ndim != 2 or rows.shape[1] != n:
        raise Refusal(f"C must be ({n},) or (p, {n}) to go with Phi, but its shape is {C.shape}.")
    p = rows.shape[0]
    if Q.shape != (n, n):
        raise Refusal(f"Q must be ({n}, {n}) to go with Phi, but its shape is {Q.shape}.")
    noise = R * np.eye(p) if R.ndim == 0 else R
    if noise.shape != (p, p):
        raise Refusal(f"R must be a scalar or ({p}, {p}) to go with C, but its shape is {R.shape}.")
    _symmetric("Q", Q)
    _symmetric("R", noise)
    smallest = float(np.linalg.eigvalsh(Q)[0])
    if smallest < -1e-12 * max(1.0, float(np.abs(Q).max())):
        raise Refusal(f"Q must be positive semi-definite, but its smallest eigenvalue is {smallest:.3g}.")
    smallest = float(np.linalg.eigvalsh(noise)[0])
    if smallest <= 0.0:
        raise Refusal(f"R must be positive definite, but its smallest eigenvalue is {smallest:.3g}.")

    refusal = (
        "The Riccati equation has no stabilising solution: every mode of Phi that is not stable must be seen by C "
        "(detectability), and every mode on the unit circle must be driven by Q."
    )
    try:
        # SciPy warns where it balances a badly scaled pencil; what it finds is checked below.
        with np.errstate(all="ignore"):
            P = scipy.linalg.solve_discrete_are(Phi.T, rows.T, Q, noise)
    except np.linalg.LinAlgError as error:
        raise Refusal(refusal) from error
    P = 0.5 * (P + P.T)
    S = rows @ P @ rows.T + noise
    gain = np.linalg.solve(S, rows @ P).T
    keep = np.eye(n) - gain @ rows
    filtered = keep @ P @ keep.T + gain @ noise @ gain.T
    residual = float(np.abs(Phi @ filtered @ Phi.T + Q - P).max())
    radius = float(np.abs(np.linalg.eigvals(keep @ Phi)).max())
    if not (np.isfinite(P).all() and radius < 1.0 - 1e-9):
        raise Refusal(f"{refusal} Spectral radius of (I - K C) Phi: {radius:.6g}.")
    if residual > 1e-7 * float(np.abs(P).max()):
        raise Refusal(
            f"The Riccati equation is too badly scaled to be solved: its residual is {residual:.3g} beside a "
            f"covariance of {np.abs(P).max():.3g}. Scale the states, or bring Q and R closer together."
        )
    return SteadyStateFilter(
        gain=jnp.asarray(gain[:, 0] if single else gain),
        prediction_covariance=jnp.asarray(P),
        filtered_covariance=jnp.asarray(0.5 * (filtered + filtered.T)),
        innovation_covariance=jnp.asarray(S[0, 0] if single else S),
    )


def _finite_array(name: str, value: jax.typing.ArrayLike) -> npt.NDArray[np.float64]:
    array = np.asarray(value, dtype=np.float64)
    if not np.isfinite(array).all():
        raise Refusal(f"{name} must be finite, but it holds {array[~np.isfinite(array)].ravel()[0]}.")
    return array


def _symmetric(name: str, matrix: npt.NDArray[np.float64]) -> None:
    skew = float(np.abs(matrix - matrix.T).max())
    if skew > 1e-10 * max(float(np.abs(matrix).max()), 1e-300):
        raise Refusal(f"{name} must be symmetric, but it differs from its transpose by {skew:.3g}.")


# At every sample ------------------------------------------------------------------------------------------------------


def _propagate(Phi: jax.Array, P: jax.Array, Q: jax.Array) -> jax.Array:
    """``Phi P Phi' + Q``, symmetric to the last bit."""
    half = jnp.einsum("ij...,jk...->ik...", Phi, P)
    full = jnp.einsum("ik...,jk...->ij...", half, Phi)
    return 0.5 * (full + jnp.swapaxes(full, 0, 1)) + _people(Q, full)


def _people(a: jax.Array, like: jax.Array) -> jax.Array:
    """Give an array without people the people axis of another."""
    return a[..., None] if a.ndim < like.ndim else a


def _correct(P: jax.Array, C: jax.Array, R: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
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


def predict(
    state: KalmanState, Phi: jax.typing.ArrayLike, Q: jax.typing.ArrayLike, forcing: jax.typing.ArrayLike = 0.0
) -> KalmanState:
    """Carry an estimate over one sample: ``Phi x + forcing`` and ``Phi P Phi' + Q``.

    Parameters
    ----------
    state
        Estimate at sample k.
    Phi, Q : (n, n) or (n, n, B)
        Transition matrix, and covariance of the process noise.
    forcing : (n,), (n, B) or scalar
        Contribution of the known inputs, ``Gamma u``.
    """
    Phi, Q = jnp.asarray(Phi), jnp.asarray(Q)
    mean = jnp.einsum("ij...,j...->i...", Phi, state.mean)
    added = jnp.asarray(forcing)
    if 0 < added.ndim < mean.ndim:
        added = added[:, None]
    elif mean.ndim < added.ndim:
        mean = mean[:, None]
    return KalmanState(mean=mean + added, covariance=_propagate(Phi, state.covariance, Q))


def update(
    state: KalmanState,
    reading: jax.typing.ArrayLike,
    C: jax.typing.ArrayLike,
    R: jax.typing.ArrayLike,
    valid: jax.typing.ArrayLike = True,
) -> tuple[KalmanState, Innovation]:
    """Correct a prediction by a reading, and tell the innovation.

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
    reading: jax.typing.ArrayLike,
    Phi: jax.typing.ArrayLike,
    C: jax.typing.ArrayLike,
    Q: jax.typing.ArrayLike,
    R: jax.typing.ArrayLike,
    *,
    forcing: jax.typing.ArrayLike = 0.0,
    valid: jax.typing.ArrayLike = True,
) -> tuple[KalmanState, Innovation]:
    """One sample of the time-varying filter: `predict` with the input applied since the last reading, then `update`.

    Its arguments and results are those of the two: the model between samples k-1 and k, and ``Gamma u(k-1)``.
    """
    return update(predict(state, Phi, Q, forcing), reading, C, R, valid)


def riccati_step(
    P: jax.typing.ArrayLike,
    Phi: jax.typing.ArrayLike,
    C: jax.typing.ArrayLike,
    Q: jax.typing.ArrayLike,
    R: jax.typing.ArrayLike,
) -> jax.Array:
    """Prediction covariance one sample on: ``Phi (P - P C' (C P C' + R)^-1 C P) Phi' + Q``, symmetric.

    The shapes are those of `predict` and `update`.
    """
    filtered, _, _ = _correct(jnp.asarray(P), jnp.asarray(C), jnp.asarray(R))
    return _propagate(jnp.asarray(Phi), filtered, jnp.asarray(Q))


def filter_gain(P: jax.typing.ArrayLike, C: jax.typing.ArrayLike, R: jax.typing.ArrayLike) -> jax.Array:
    """Filter-form gain ``P C' / (C P C' + R)`` that belongs to a prediction covariance.

    The shapes are those of `predict` and `update`.
    """
    C = jnp.asarray(C)
    seen = jnp.einsum("ij...,j...->i...", jnp.asarray(P), C)
    return seen / (jnp.einsum("i...,i...->...", _people(C, seen), seen) + jnp.asarray(R))
