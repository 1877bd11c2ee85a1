"""First and final step of every controller: what an observation says, and a decision within the limits, for any input.

A person may announce a meal before eating and say when it will be eaten, so that insulin given at the announcement has
begun to act by then. Therapies dose at the announcement; a model begins the meal when it is eaten, see `hear`.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.pumps.limits import BolusLimits, DoseLimits
from glucoloop.units import LONGEST_AHEAD_MIN

_SATURATED_MU_MIN: Final = 1e-9
_MAX_CARBS_G: Final = 1000.0
"""Largest carbohydrate of a meal that is accepted."""
_EXERCISE_TARGET_MG_DL: Final = 150.0
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
    """Whether an estimate of glucose can be that of a person, so that the estimate need not begin again; NaN cannot."""
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


def is_eating(observation: Observation) -> jax.Array:
    """Whether a possible meal is announced at this sample."""
    carbs = observation.announced_carbs_g
    return (carbs > 0.0) & (carbs <= _MAX_CARBS_G)


def announced_carbs(observation: Observation) -> jax.Array:
    """Announced carbohydrate [g], or 0 where there is none or it is impossible."""
    return jnp.where(is_eating(observation), observation.announced_carbs_g, 0.0)


def with_rescue(carbs_g: jax.Array, observation: Observation) -> jax.Array:
    """Carbohydrate that begins, with what was eaten against low glucose where that is told and possible.

    A model counts both alike; a bolus is for the announced carbohydrate alone.
    """
    rescue = observation.rescue_carbs_g
    if rescue is None:
        return carbs_g
    return carbs_g + jnp.where((rescue > 0.0) & (rescue <= _MAX_CARBS_G), rescue, 0.0)


def target_mg_dl(observation: Observation) -> jax.Array:
    """Setpoint, or the higher target of announced exercise from its announcement to its end.

    150 mg/dl is the target that D. P. Zaharieva et al., "Practical aspects and exercise safety benefits of automated
    insulin delivery systems in type 1 diabetes", Diabetes Spectr. 36(2), 2023, 127-136, find in use before and in
    exercise.
    """
    setpoint, ahead_min = observation.setpoint_mg_dl, observation.exercise_in_min
    if ahead_min is None:
        return setpoint
    return jnp.where(ahead_min < jnp.inf, jnp.maximum(setpoint, _EXERCISE_TARGET_MG_DL), setpoint)


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


MEALS: Final = 4
"""Announced meals that can be awaited at once; of a further one the oldest is taken to begin."""


@pytree
class MealsToCome:
    """Announced meals ``(meals, ...)`` that are still to be eaten, the newest first; a meal of 0 g is none."""

    carbs_g: jax.Array
    in_min: jax.Array
    """Time from the coming sample until each is eaten."""


def no_meals_to_come(observation: Observation) -> MealsToCome | None:
    """Empty memory of meals, or None where observations tell no time of eating."""
    if observation.announced_in_min is None:
        return None
    none = jnp.stack([jnp.zeros_like(observation.announced_carbs_g)] * MEALS)
    return MealsToCome(carbs_g=none, in_min=none)


def eaten_in_min(observation: Observation) -> jax.Array:
    """Time until the announced meal is eaten; 0 where no time or an impossible one is told."""
    ahead_min = observation.announced_in_min
    if ahead_min is None:
        return jnp.zeros_like(observation.announced_carbs_g)
    return jnp.where((ahead_min >= 0.0) & (ahead_min <= LONGEST_AHEAD_MIN), ahead_min, 0.0)


def hear(
    to_come: MealsToCome | None, observation: Observation, carbs_g: jax.Array, sample_time_min: float
) -> tuple[MealsToCome | None, jax.Array]:
    """Meals that are still to be eaten after an announcement, and the carbohydrate that begins in the coming sample.

    `to_come` is what this function returned a sample before; where it is None, what is announced begins at once.
    """
    if to_come is None:
        return None, carbs_g
    awaited = jnp.where((to_come.carbs_g > 0.0) & (to_come.carbs_g <= _MAX_CARBS_G), to_come.carbs_g, 0.0)
    left_min = jnp.where(to_come.in_min <= LONGEST_AHEAD_MIN, to_come.in_min - sample_time_min, 0.0)
    carbs = jnp.concatenate([carbs_g[None], awaited])
    in_min = jnp.concatenate([eaten_in_min(observation)[None], left_min])
    waits = (carbs > 0.0) & (in_min >= sample_time_min)
    begins = jnp.sum(jnp.where(waits, 0.0, carbs), axis=0)
    carbs, in_min = jnp.where(waits, carbs, 0.0), jnp.where(waits, in_min, 0.0)
    new = waits[0]
    begins = begins + jnp.where(new, carbs[-1], 0.0)
    return MealsToCome(
        carbs_g=jnp.where(new, carbs[:-1], carbs[1:]), in_min=jnp.where(new, in_min[:-1], in_min[1:])
    ), begins
