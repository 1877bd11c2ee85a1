"""Constraints (17) to (19) of Parker, Doyle & Peppas 1999 on the delivered insulin and on glucose.

Time stands on the leading axis; people trail. Values that are not finite violate every constraint.
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from glucoloop.pumps.limits import DoseLimits

LOWEST_GLUCOSE_MG_DL: Final = 60.0
"""Lower bound on glucose, constraint (19)."""

ROUNDING_MU_MIN: Final = 1e-9
"""Tolerance for rounding, so that a dose at its limit is within it."""


def insulin_changes(insulin_mU_min: ArrayLike, before_mU_min: ArrayLike) -> jax.Array:
    """Change of the infusion at each sample, the first from the rate before the run.

    Parameters
    ----------
    insulin_mU_min : array_like, shape (samples, ...)
        Rates delivered from each sample to the next.
    before_mU_min : array_like, shape () or (...)
        The rate at rest.

    Returns
    -------
    Array, shape (samples, ...)
        Changes in mU/min.
    """
    insulin = jnp.asarray(insulin_mU_min, dtype=float)
    before = jnp.broadcast_to(jnp.asarray(before_mU_min, dtype=float), insulin.shape[1:])
    return jnp.diff(insulin, axis=0, prepend=before[None])


def rate_satisfied(insulin_mU_min: ArrayLike, before_mU_min: ArrayLike, limits: DoseLimits) -> jax.Array:
    """Whether no change exceeds its limit, (17); arguments as for `insulin_changes`."""
    changes = jnp.abs(insulin_changes(insulin_mU_min, before_mU_min))
    return (changes <= limits.max_change_mU_min + ROUNDING_MU_MIN).all(axis=0)


def magnitude_satisfied(insulin_mU_min: ArrayLike, limits: DoseLimits) -> jax.Array:
    """Whether every rate is within its limits, (18); insulin as for `insulin_changes`."""
    insulin = jnp.asarray(insulin_mU_min)
    within = (insulin >= limits.min_mU_min - ROUNDING_MU_MIN) & (insulin <= limits.max_mU_min + ROUNDING_MU_MIN)
    return within.all(axis=0)


def glucose_satisfied(glucose_mg_dl: ArrayLike, lowest_mg_dl: ArrayLike = LOWEST_GLUCOSE_MG_DL) -> jax.Array:
    """Whether glucose never falls below the bound, (19).

    Parameters
    ----------
    glucose_mg_dl : array_like, shape (points, ...)
        Glucose free of noise.
    lowest_mg_dl : array_like
    """
    glucose = jnp.asarray(glucose_mg_dl)
    return (jnp.isfinite(glucose) & (glucose >= lowest_mg_dl)).all(axis=0)
