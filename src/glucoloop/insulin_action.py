"""Course of the action of a dose of rapid-acting insulin, as open-source systems take it.

The exponential curve of D. Maksimovic (2017), which oref0 (`lib/iob/calculate.js`) and LoopKit
(`ExponentialInsulinModel`) use. It is given by the time at which the action is largest and that at which it ends.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike


class RapidInsulin(NamedTuple):
    """Times of a kind of insulin, in minutes."""

    action_min: float
    """Time from the beginning of the action to its end."""
    peak_min: float
    """Time from the beginning of the action to its peak, less than half of that to the end."""
    delay_min: float
    """Time from the dose to the beginning of the action."""


INSULINS: Final = {
    "rapid-adult": RapidInsulin(360.0, 75.0, 10.0),
    "rapid-child": RapidInsulin(360.0, 65.0, 10.0),
    "fiasp": RapidInsulin(360.0, 55.0, 10.0),
    "lyumjev": RapidInsulin(360.0, 55.0, 10.0),
}
"""Insulins under the skin by name, of LoopKit's `ExponentialInsulinModelPreset`."""


def action_per_min(t_min: ArrayLike, action_min: ArrayLike, peak_min: ArrayLike) -> jax.Array:
    """Part of a dose that acts in a minute, at a time after its action began; its area is 1.

    ::

        a(t) = S / tau^2 t (1 - t / t_d) exp(-t / tau),   tau = t_p (1 - t_p / t_d) / (1 - 2 t_p / t_d)
        S = 1 / (1 - 2 tau / t_d + (1 + 2 tau / t_d) exp(-t_d / tau))
    """
    tau, _, S = _shape(action_min, peak_min)
    t = jnp.clip(jnp.asarray(t_min, float), 0.0, action_min)
    return S / tau**2 * t * (1.0 - t / action_min) * jnp.exp(-t / tau)


def insulin_left(t_min: ArrayLike, action_min: ArrayLike, peak_min: ArrayLike) -> jax.Array:
    """Part of a dose that has not acted yet, at a time after its action began: 1 before it, and 0 after its end."""
    tau, a, S = _shape(action_min, peak_min)
    t = jnp.clip(jnp.asarray(t_min, float), 0.0, action_min)
    course = (t**2 / (tau * action_min * (1.0 - a)) - t / tau - 1.0) * jnp.exp(-t / tau) + 1.0
    return 1.0 - S * (1.0 - a) * course


def _shape(action_min: ArrayLike, peak_min: ArrayLike) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Time constant, twice that over the time of action, and scale of the curve."""
    action, peak = jnp.asarray(action_min, float), jnp.asarray(peak_min, float)
    tau = peak * (1.0 - peak / action) / (1.0 - 2.0 * peak / action)
    a = 2.0 * tau / action
    return tau, a, 1.0 / (1.0 - a + (1.0 + a) * jnp.exp(-action / tau))
