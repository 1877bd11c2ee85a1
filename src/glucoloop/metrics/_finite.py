"""A run that left the numbers has no metrics: better NaN than a value that looks like one."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike


def all_or_nan(values: ArrayLike) -> jax.Array:
    """The values, or NaN throughout for a person for whom any is not finite.

    Comparisons and extremes would pass over a NaN; times in range and least values would then be told of the part
    of the run that happened to go well.

    Parameters
    ----------
    values : array_like, shape (points, ...)

    Returns
    -------
    Array, shape (points, ...)
    """
    values = jnp.asarray(values, dtype=float)
    return jnp.where(jnp.isfinite(values).all(axis=0), values, jnp.nan)


def nan_where_nan(result: jax.Array, source: jax.Array) -> jax.Array:
    """A result of comparisons, which know no NaN, with the NaN of what was compared."""
    return jnp.where(jnp.isnan(source), jnp.nan, result)
