"""Course of the absorption of a meal as LoopKit takes it: a rate that rises, stays and falls in straight lines.

LoopKit, `PiecewiseLinearAbsorption` (LoopAlgorithm, `CarbMath.swift`). It rises for 15 % of the absorption time, stays
to 50 %, and falls to 0 at the end.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp

_RISES_TO: Final = 0.15
_FALLS_FROM: Final = 0.5
_RATE: Final = 2.0 / (1.0 + _FALLS_FROM - _RISES_TO)
"""Greatest rate, in meals per absorption time, by which all of the meal is absorbed."""


def rate_of_absorption(x: jax.Array) -> jax.Array:
    """Rate, in meals per absorption time, at a part x of the absorption time; 0 outside of it."""
    falls = (1.0 - x) / (1.0 - _FALLS_FROM)
    return _RATE * jnp.clip(jnp.minimum(x / _RISES_TO, falls), 0.0, 1.0)


def part_absorbed(x: jax.Array) -> jax.Array:
    """Part of a meal that is absorbed at a part x of the absorption time, the integral of the rate."""
    rising = jnp.clip(x, 0.0, _RISES_TO)
    flat = jnp.clip(x, _RISES_TO, _FALLS_FROM) - _RISES_TO
    falling = jnp.clip(x, _FALLS_FROM, 1.0) - _FALLS_FROM
    return _RATE * (rising**2 / (2.0 * _RISES_TO) + flat + falling * (1.0 - falling / (2.0 * (1.0 - _FALLS_FROM))))


def time_of_part(part: jax.Array) -> jax.Array:
    """Part of the absorption time at which a part of a meal is absorbed, from 0 to 1: the inverse."""
    rising = jnp.sqrt(2.0 * _RISES_TO / _RATE * jnp.maximum(part, 0.0))
    flat = 0.5 * _RISES_TO + part / _RATE
    falling = 1.0 - jnp.sqrt(2.0 * (1.0 - _FALLS_FROM) / _RATE * jnp.maximum(1.0 - part, 0.0))
    return jnp.where(rising < _RISES_TO, rising, jnp.where(flat < _FALLS_FROM, flat, falling))
