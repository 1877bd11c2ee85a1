"""Legendre moments of the appearance of glucose over a step, by which meals enter the integrators.

The moments of a rate over a step of length h are ``integral of rate(t + h s) P_n(2 s - 1) ds over 0 <= s <= 1`` for
n = 0, 1, 2. Three numbers say the same as the quadratic that has these moments.
"""

from __future__ import annotations

import functools
import math
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


def moments_of_steps(moments: jax.Array, steps: int) -> jax.Array:
    """Moments ``(steps, 3, ...)`` of equal steps of a time, from those ``(n, 3, ...)`` of n equal steps of it.

    They are those of the quadratic over each of the n steps: exact where several of them make one.
    """
    if moments.shape[0] == steps:
        return moments
    return jnp.tensordot(jnp.asarray(_steps_matrix(moments.shape[0], steps), moments.dtype), moments, 2)


@functools.cache
def _steps_matrix(n: int, steps: int) -> npt.NDArray[np.float64]:
    """Matrix ``(steps, 3, n, 3)`` of `moments_of_steps`, by way of parts of which whole numbers make both steps."""
    parts = math.lcm(n, steps)
    # P_n of a step, seen from a part of it, at the nodes of the part; the quadratic has 2 n + 1 times its moments
    of_old, of_new = (
        legendre((np.arange(parts) % each)[:, None] / each + NODES / each) for each in (parts // n, parts // steps)
    )
    values = of_old * np.array([1.0, 3.0, 5.0])
    each_part = np.einsum("pkj,pki,k->pji", of_new, values, WEIGHTS) * (steps / parts)
    matrix = np.zeros((steps, 3, n, 3))
    for part, entries in enumerate(each_part):
        matrix[part * steps // parts, :, part * n // parts] += entries
    return matrix


def legendre(s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """P_0, P_1 and P_2 of 2 s - 1, on the last axis."""
    x = 2.0 * s - 1.0
    return np.stack([np.ones_like(x), x, 1.5 * x * x - 0.5], axis=-1)


def points_of_sample(sample_time_min: float) -> int:
    """Number of moments of the fine grid in a sample: one about every minute, the end of the sample included."""
    return max(1, round(sample_time_min))
