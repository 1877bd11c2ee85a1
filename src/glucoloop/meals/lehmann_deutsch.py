"""Glucose appearance after meals: gastric emptying and gut absorption of Lehmann and Deutsch (1992).

The stomach empties at a rate E(t) that rises along a ramp, stays on a plateau, and falls along a ramp. The gut holds
q mg and passes on ``q / T``: ``q' = E(t) - q / T``. E is piecewise linear, so both have closed forms in which every
kink is exact. A meal is carried as its four kinks, and meals superpose by listing all of theirs.

References
----------
E. D. Lehmann, T. Deutsch, "A physiological model of glucose-insulin interaction in type 1 diabetes mellitus",
J. Biomed. Eng. 14, 1992.
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree
from glucoloop.units import MG_PER_G

PLATEAU_MG_MIN: Final = 360.0
RAMP_MIN: Final = 30.0
GUT_TIME_CONSTANT_MIN: Final = 60.0

# Nodes and weights on [0, 1]; the appearance is smooth between kinks on the scale of an hour, so six are exact to
# rounding over a quarter of an hour.
_NODES, _WEIGHTS = (np.polynomial.legendre.leggauss(6)[0] + 1.0) / 2.0, np.polynomial.legendre.leggauss(6)[1] / 2.0


@pytree
class Emptying:
    """Gastric emptying as the changes of its slope, `(kinks, ...)`, people trailing."""

    t_min: jax.Array
    """Time of each kink."""
    slope_change_mg_min2: jax.Array
    """By how much the slope of E changes there."""


@jax.jit
def emptying(t_min: jax.Array, carbs_g: jax.Array) -> Emptying:
    """Gastric emptying after meals.

    Parameters
    ----------
    t_min, carbs_g : (meals, ...) array
        When each meal begins and its carbohydrate. A meal of 0 g contributes nothing.

    Returns
    -------
    Emptying
        ``4 * meals`` kinks. Meals of less than 10.8 g have shorter ramps and no plateau, with the same peak.
    """
    dose_mg = jnp.asarray(carbs_g, float) * MG_PER_G
    ramp = jnp.minimum(RAMP_MIN, dose_mg / PLATEAU_MG_MIN)
    slope = jnp.where(dose_mg > 0.0, PLATEAU_MG_MIN / jnp.where(ramp > 0.0, ramp, 1.0), 0.0)
    fall = jnp.maximum(dose_mg / PLATEAU_MG_MIN, ramp)  # the rise and the plateau together
    starts = jnp.stack([jnp.zeros_like(ramp), ramp, fall, fall + ramp])
    signs = jnp.asarray([1.0, -1.0, -1.0, 1.0]).reshape(4, *[1] * ramp.ndim)
    return Emptying(
        t_min=(jnp.asarray(t_min, float) + starts).reshape(-1, *ramp.shape[1:]),
        slope_change_mg_min2=(signs * slope).reshape(-1, *ramp.shape[1:]),
    )


def emptying_mg_min(t_min: jax.Array, kinks: Emptying) -> jax.Array:
    """Rate E(t) at which the stomach empties into the gut."""
    return jnp.sum(kinks.slope_change_mg_min2 * jnp.maximum(t_min - kinks.t_min, 0.0), axis=0)


def _ramp_response(z: jax.Array) -> jax.Array:
    """Gut content over its time constant, after a ramp of unit slope that began z minutes ago."""
    T = GUT_TIME_CONSTANT_MIN
    z = jnp.maximum(z, 0.0)
    return z + T * jnp.expm1(-z / T)


def appearance_mg_min(t_min: jax.Array, kinks: Emptying) -> jax.Array:
    """Rate at which glucose appears in the blood of the gut, at the time `t_min`, a scalar or `(...)`."""
    return jnp.sum(kinks.slope_change_mg_min2 * _ramp_response(t_min - kinks.t_min), axis=0)


def appearance_moments(t_min: jax.Array, step_min: float, kinks: Emptying) -> jax.Array:
    """Exact Legendre moments of the appearance over one step.

    Parameters
    ----------
    t_min : scalar
        Start of the step.
    step_min : float
        Its length h.
    kinks : Emptying

    Returns
    -------
    (3, ...) array
        ``integral of appearance(t + h s) P_n(2 s - 1) ds over 0 <= s <= 1`` for n = 0, 1, 2 in mg/min, with the
        kinks inside the step honoured: each ramp is integrated from the moment it begins.
    """
    since = kinks.t_min - t_min
    begin = jnp.clip(since / step_min, 0.0, 1.0)
    total = jnp.zeros((3, *kinks.t_min.shape[1:]))
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        s = begin + (1.0 - begin) * node
        rate = kinks.slope_change_mg_min2 * _ramp_response(s * step_min - since) * (weight * (1.0 - begin))
        x = 2.0 * s - 1.0
        total = total + jnp.sum(jnp.stack([rate, rate * x, rate * (1.5 * x * x - 0.5)]), axis=1)
    return total
