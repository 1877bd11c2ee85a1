"""How much insulin a guard allows: by the hour, on board, and against a sensor that may read too high.

Insulin on board is told in basal rates beyond the basal rate: it is 1 after long at twice the basal rate.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.control.guard_settings import GuardSettings
from glucoloop.units import MIN_PER_H


@pytree
class Given:
    """What was given, and what is thought of it."""

    basal_mU_min: jax.Array
    per_basal: jax.Array
    """One over it; 0 where it is 0."""
    on_board: jax.Array
    hour_mU_min: jax.Array
    """(samples, ...) rates of the last hour but one sample, the oldest first."""
    doubted_mg_dl: jax.Array
    """What is put down to the sensor, of what seems to need insulin; below 0 it has jumped down and may jump back."""


def first_given(basal_mU_min: jax.Array, sample_time_min: float) -> Given:
    """After long at the basal rate."""
    others = max(round(MIN_PER_H / sample_time_min), 1) - 1
    zero = jnp.zeros_like(basal_mU_min)
    some = basal_mU_min > 0.0
    return Given(
        basal_mU_min=basal_mU_min,
        per_basal=jnp.where(some, 1.0 / jnp.where(some, basal_mU_min, 1.0), 0.0),
        on_board=zero,
        hour_mU_min=jnp.broadcast_to(basal_mU_min, (others, *basal_mU_min.shape)),
        doubted_mg_dl=zero,
    )


def take_in(
    given: Given,
    delivered_mU_min: jax.Array,
    above_setpoint_mg_dl: jax.Array,
    jump_mg_dl: jax.Array,
    settings: GuardSettings,
    sample_time_min: float,
) -> Given:
    """Take in the rate of the last sample, and what may be put down to the sensor.

    Parameters
    ----------
    given : Given
    delivered_mU_min : (...) array
    above_setpoint_mg_dl : (...) array
        Glucose less the setpoint.
    jump_mg_dl : (...) array
        By how much the reading jumped, if it did. Glucose does not: it is put down to the sensor, as far as more
        insulin seems to be needed, and forgotten little by little.
    settings : GuardSettings
    sample_time_min : float
    """
    kept = math.exp(-sample_time_min / settings.on_board_tau_min)
    beyond = (delivered_mU_min - given.basal_mU_min) * given.per_basal
    on_board = kept * given.on_board + (1.0 - kept) * beyond
    # What glucose is above the setpoint, and what insulin on board has taken off it.
    need = above_setpoint_mg_dl + settings.fall_mg_dl * on_board
    doubted = math.exp(-sample_time_min / settings.doubt_tau_min) * given.doubted_mg_dl + jump_mg_dl
    return Given(
        basal_mU_min=given.basal_mU_min,
        per_basal=given.per_basal,
        on_board=on_board,
        hour_mU_min=jnp.concatenate([given.hour_mU_min, delivered_mU_min[None]])[1:],
        doubted_mg_dl=jnp.minimum(doubted, jnp.maximum(need, 0.0)),
    )


def most(given: Given, above_setpoint_mg_dl: jax.Array, settings: GuardSettings, sample_time_min: float) -> jax.Array:
    """Largest rate allowed for the coming sample; never less than the basal rate.

    Insulin on board may grow by as much as takes glucose down to the setpoint, if the sensor reads too high by its
    error and by what is doubted.

    Parameters
    ----------
    given : Given
    above_setpoint_mg_dl : (...) array
        Glucose less the setpoint.
    settings : GuardSettings
    sample_time_min : float
    """
    kept = math.exp(-sample_time_min / settings.on_board_tau_min)
    surely = above_setpoint_mg_dl - jnp.maximum(given.doubted_mg_dl, 0.0) - settings.error_mg_dl
    on_board = jnp.minimum(given.on_board + surely * (1.0 / settings.fall_mg_dl), settings.max_on_board)
    by_board = 1.0 + (on_board - kept * given.on_board) * (1.0 / (1.0 - kept))
    others = given.hour_mU_min.shape[0]
    by_hour = settings.max_hour * (others + 1) * given.basal_mU_min
    if others:
        by_hour = by_hour - jnp.sum(given.hour_mU_min, axis=0)
    most_mU_min = jnp.maximum(by_board, settings.always_basal) * given.basal_mU_min
    return jnp.maximum(jnp.minimum(most_mU_min, by_hour), given.basal_mU_min)
