"""Rounding as JavaScript has it, since oref0 rounds at many places and a dose can hang on one."""

from __future__ import annotations

from glucoloop._lazy_jax import jax, jnp


def whole(value: jax.Array) -> jax.Array:
    """``Math.round``: the nearest whole number, of two the larger."""
    below = jnp.floor(value)
    return jnp.where(value >= below + 0.5, below + 1.0, below)


def rounded(value: jax.Array, digits: int) -> jax.Array:
    """A number to decimal places, as ``round`` of ``determine-basal.js``."""
    scale = 10.0**digits
    return whole(value * scale) / scale


def fixed(value: jax.Array) -> jax.Array:
    """``toFixed(2)``: two decimal places, of two the one that is farther from zero."""
    return jnp.sign(value) * rounded(jnp.abs(value), 2)


def numbered(count: int, like: jax.Array, first: int = 0) -> jax.Array:
    """Whole numbers ``(count,)`` that go with people ``(people,)``, in their precision."""
    numbers = jnp.arange(first, first + count, dtype=like.dtype)
    return numbers.reshape((count,) + (1,) * like.ndim)
