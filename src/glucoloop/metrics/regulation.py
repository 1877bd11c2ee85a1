"""Regulation of glucose to its setpoint: the measures of Parker, Doyle & Peppas 1999, Tables I and II.

Glucose is free of noise. Time stands on the leading axis; people trail. A person whose glucose is not finite
throughout gets NaN, and is not settled.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from glucoloop._pytree import pytree
from glucoloop.metrics._finite import all_or_nan, nan_where_nan


@pytree
class Extreme:
    """A least or greatest value, and the time at which it was first reached."""

    value: jax.Array
    """(...) least or greatest value."""
    t_min: jax.Array
    """(...) time at which it is first reached."""


@pytree
class Settling:
    """Settling time of glucose."""

    settling_min: jax.Array
    """(...) settling time in minutes; a lower bound if glucose is not settled."""
    settled: jax.Array
    """(...) whether glucose is inside the band at the end."""


def minimum(t_min: ArrayLike, glucose_mg_dl: ArrayLike) -> Extreme:
    """Least glucose [mg/dl], and the time at which it is first reached [min].

    Parameters
    ----------
    t_min : array_like, shape (points,)
    glucose_mg_dl : array_like, shape (points, ...)
    """
    glucose = all_or_nan(glucose_mg_dl)
    value = glucose.min(axis=0)
    return Extreme(value=value, t_min=nan_where_nan(jnp.asarray(t_min)[glucose.argmin(axis=0)], value))


def peak(t_min: ArrayLike, glucose_mg_dl: ArrayLike) -> Extreme:
    """Greatest glucose [mg/dl], and the time at which it is first reached [min]; arguments as for `minimum`."""
    glucose = all_or_nan(glucose_mg_dl)
    value = glucose.max(axis=0)
    return Extreme(value=value, t_min=nan_where_nan(jnp.asarray(t_min)[glucose.argmax(axis=0)], value))


def settling(
    t_min: ArrayLike,
    glucose_mg_dl: ArrayLike,
    setpoint_mg_dl: ArrayLike,
    *,
    band_pct: ArrayLike,
    from_min: ArrayLike = 0.0,
) -> Settling:
    """Time from `from_min` until glucose enters a band around the setpoint for good.

    The first point of the grid after the last one with ``|glucose - setpoint| > band_pct / 100 * setpoint``, less
    `from_min`: on a grid of one minute, the last minute outside, plus 1, less the time of the meal. It is 0 if glucose
    is never outside, or not after `from_min`. If glucose is outside at the last point it has not settled, and the time
    is that of the point which would follow, less `from_min`: a lower bound.

    Parameters
    ----------
    t_min : array_like, shape (points,)
        An even grid of two points or more.
    glucose_mg_dl : array_like, shape (points, ...)
    setpoint_mg_dl : array_like, shape () or (...)
    band_pct : array_like
        Half width of the band, in percent of the setpoint.
    from_min : array_like
        Time at which the disturbance begins.
    """
    t = jnp.asarray(t_min)
    glucose = all_or_nan(glucose_mg_dl)
    setpoint = jnp.asarray(setpoint_mg_dl)
    outside = jnp.abs(glucose - setpoint) > jnp.asarray(band_pct) / 100.0 * setpoint
    last = t.shape[0] - 1 - outside[::-1].argmax(axis=0)
    after_last = t[last] + (t[1] - t[0])
    settling_min = jnp.where(outside.any(axis=0), jnp.maximum(after_last - from_min, 0.0), 0.0)
    return Settling(
        settling_min=nan_where_nan(settling_min, glucose[-1] - setpoint),
        settled=~outside[-1] & jnp.isfinite(glucose[-1] - setpoint),
    )


def sum_squared_error(glucose_mg_dl: ArrayLike, setpoint_mg_dl: ArrayLike) -> jax.Array:
    """Sum over samples of ``(glucose - setpoint)^2`` [(mg/dl)^2].

    Parameters
    ----------
    glucose_mg_dl : array_like, shape (samples, ...)
        Glucose at the controller's samples; the sum grows with their number.
    setpoint_mg_dl : array_like, shape () or (...)
    """
    return ((all_or_nan(glucose_mg_dl) - jnp.asarray(setpoint_mg_dl)) ** 2).sum(axis=0)
