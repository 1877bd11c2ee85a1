"""Final step of every controller: from a wanted rate to a decision within the limits, for any input."""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.pumps.limits import BolusLimits, DoseLimits

_SATURATED_MU_MIN: Final = 1e-9
_MAX_CARBS_G: Final = 1000.0
"""Largest carbohydrate of a meal that is accepted."""
_LOWEST_MG_DL: Final = -1000.0
"""Lowest estimate of glucose that is used. A linear model goes below zero where it errs about much insulin; the error
of one that is further off than any reading (40 to 600 mg/dl) can be high is no longer that of a model.
"""
_HIGHEST_MG_DL: Final = 3000.0
"""Highest estimate of glucose that is used; no person is known to have survived more than 2656 mg/dl."""


def is_known(observation: Observation) -> jax.Array:
    """Whether there is a valid reading."""
    return observation.valid & jnp.isfinite(observation.glucose_mg_dl)


def is_of_a_person(glucose_mg_dl: jax.Array) -> jax.Array:
    """Whether an estimate of glucose can be that of a person, so that the estimate need not begin anew; NaN cannot."""
    return (glucose_mg_dl >= _LOWEST_MG_DL) & (glucose_mg_dl <= _HIGHEST_MG_DL)


def rate_at_start(observation: Observation, otherwise_mU_min: jax.Array | float) -> jax.Array:
    """Rate in force when a controller starts, or the given one if the pump reports none."""
    return delivered_since(observation, jnp.asarray(otherwise_mU_min))


def delivered_since(observation: Observation, previous_mU_min: jax.Array) -> jax.Array:
    """Rate that the pump delivered since the last sample, or the previous one if the pump reports none."""
    return jnp.where(jnp.isfinite(observation.delivered_mU_min), observation.delivered_mU_min, previous_mU_min)


def bolus_since(observation: Observation, requested_mU: jax.Array, limits: BolusLimits) -> jax.Array:
    """Bolus since the last sample: the reported one, or the requested one if the report is impossible."""
    word = observation.delivered_bolus_mU
    if word is None:
        return requested_mU
    return jnp.where((word >= 0.0) & (word <= limits.max_mU), word, requested_mU)


def announced_carbs(observation: Observation) -> jax.Array:
    """Announced carbohydrate [g], or 0 where there is none or it is impossible."""
    carbs = observation.announced_carbs_g
    return jnp.where((carbs > 0.0) & (carbs <= _MAX_CARBS_G), carbs, 0.0)


def decide(
    wanted_mU_min: jax.Array,
    delivered_mU_min: jax.Array,
    limits: DoseLimits,
    known: jax.Array,
    converged: jax.Array | bool = True,
) -> Decision:
    """Clip a wanted rate to the limits, or keep the delivered rate where that is not finite, and set the status."""
    finite = jnp.isfinite(wanted_mU_min)
    insulin = limits.clip(jnp.where(finite, wanted_mU_min, delivered_mU_min), delivered_mU_min)
    saturated = ~limits.allow(wanted_mU_min, delivered_mU_min, _SATURATED_MU_MIN)
    status = jnp.full_like(finite, int(Status.OK), dtype=int)
    for holds, kind in (
        (saturated, Status.SATURATED),
        (~jnp.asarray(converged), Status.NOT_CONVERGED),
        (~known, Status.READING_MISSING),
        (~finite, Status.NON_FINITE),
    ):
        status = jnp.where(holds, int(kind), status)
    return Decision(insulin_mU_min=insulin, status=status)
