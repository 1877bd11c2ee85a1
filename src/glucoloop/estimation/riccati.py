"""Prediction covariance that a filter carries along, for a model that is linearised again at every sample.

The steady covariance of each linearisation is the gain's source. From one sample to the next it changes little, so a
few steps of the Riccati equation from that of the sample before come near it, without a solve. It is kept as its lower
triangle: symmetric as stored, and half as many numbers.
"""

from __future__ import annotations

import math
from typing import Final

from glucoloop._lazy_jax import jax, jnp, np

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
