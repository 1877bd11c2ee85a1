"""Legendre moments of the appearance of glucose over a step, by which meals enter the integrators.

The moments of a rate over a step of length h are ``integral of rate(t + h s) P_n(2 s - 1) ds over 0 <= s <= 1`` for
n = 0, 1, 2. Three numbers say the same as the quadratic that has these moments.
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

# Nodes and weights on [0, 1]. The appearance is smooth between jumps, on the scale of the model's time constants: eight
# are exact to rounding over up to three of them.
_GAUSS = np.polynomial.legendre.leggauss(8)
NODES, WEIGHTS = (_GAUSS[0] + 1.0) / 2.0, _GAUSS[1] / 2.0

MOMENTS: Final = 3
# Legendre polynomials P_0, P_1, P_2 times 2 n + 1, at the start, the middle and the end of a step.
_FROM_MOMENTS: Final = np.array([[1.0, -3.0, 5.0], [1.0, 0.0, -2.5], [1.0, 3.0, 5.0]])


def at_start_middle_end(moments: jax.Array) -> jax.Array:
    """Values ``(3, ...)`` at the start, the middle and the end of a step of the quadratic that has given moments."""
    return jnp.tensordot(jnp.asarray(_FROM_MOMENTS, moments.dtype), moments, 1)


def moments_of_values(start: jax.Array, middle: jax.Array, end: jax.Array) -> jax.Array:
    """Moments ``(3, ...)`` of the quadratic through values at the start, the middle and the end of a step."""
    return jnp.stack([(start + 4.0 * middle + end) / 6.0, (end - start) / 6.0, (start + end - 2.0 * middle) / 15.0])


def moments_of_parts(moments: jax.Array, parts: int) -> jax.Array:
    """Moments ``(parts, 3, ...)`` of equal parts of a step, from those ``(3, ...)`` of the quadratic over all of it."""
    start = np.arange(parts)[:, None] / parts
    of_whole = legendre(start + NODES / parts) * np.array([1.0, 3.0, 5.0])
    matrix = np.einsum("pnk,nj,n->pjk", of_whole, legendre(NODES), WEIGHTS)
    return jnp.tensordot(jnp.asarray(matrix, moments.dtype), moments, 1)


def moments_of_whole(moments: jax.Array) -> jax.Array:
    """Moments ``(3, ...)`` of a step from those ``(parts, 3, ...)`` of its equal parts, exact for any rates."""
    parts = moments.shape[0]
    if parts == 1:
        return moments[0]
    # P_n of the whole step, seen from a part, is a quadratic again: by its values at three points of the part
    start = np.arange(parts)[:, None] / parts
    seen = legendre(start + np.array([0.0, 0.5, 1.0]) / parts)
    matrix = np.einsum("jk,pki->ipj", np.linalg.inv(legendre(np.array([0.0, 0.5, 1.0]))), seen) / parts
    return jnp.tensordot(jnp.asarray(matrix, moments.dtype), moments, 2)


def legendre(s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """P_0, P_1 and P_2 of 2 s - 1, on the last axis."""
    x = 2.0 * s - 1.0
    return np.stack([np.ones_like(x), x, 1.5 * x * x - 0.5], axis=-1)


def points_of_sample(sample_time_min: float) -> int:
    """Number of moments of the fine grid in a sample: one about every minute, the end of the sample included."""
    return max(1, round(sample_time_min))
