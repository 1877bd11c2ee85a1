"""NaN as the metric of a run with values that are not finite, since any number would be misleading."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike


def all_or_nan(values: ArrayLike) -> jax.Array:
    """The values, or NaN throughout for a person for whom any is not finite.

    Comparisons and extremes would ignore a NaN; times in range and least values would then be those of the finite part
    of the run.

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
    """A result of comparisons, which have no NaN, with NaN where the compared values have it."""
    return jnp.where(jnp.isnan(source), jnp.nan, result)
