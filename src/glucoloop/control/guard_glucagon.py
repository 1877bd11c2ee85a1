"""Glucagon that a guard allows: at most so much in any hour and in any day, and none on a reading that is not accepted.

What was given is counted by whole hours, the newest of which is not over: an hour counts with the one before it, and a
day as 25 of them, so that no window of 60 min or 24 h holds more than its cap. A dose so counts for one to two hours,
and for 24 to 25 hours.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.control.guard_settings import GuardSettings
from glucoloop.units import HOURS_PER_DAY, MIN_PER_H

_HOURS: Final = int(HOURS_PER_DAY) + 1


@pytree
class GlucagonHistory:
    """Glucagon of the last hours ``(25, ...)``, the newest last, and the minutes of that one."""

    hours_ug: jax.Array
    newest_min: jax.Array


def no_glucagon(like: jax.Array) -> GlucagonHistory:
    """History of a person who got none."""
    zero = jnp.zeros_like(like)
    return GlucagonHistory(hours_ug=jnp.stack([zero] * _HOURS), newest_min=zero)


def allowed_glucagon(
    history: GlucagonHistory, wanted_ug: jax.Array, trusted: jax.Array, settings: GuardSettings
) -> jax.Array:
    """Amount for the coming sample: what is wanted, within both caps, where the reading is one to act on."""
    left = jnp.minimum(
        settings.max_glucagon_hour_ug - history.hours_ug[-1] - history.hours_ug[-2],
        settings.max_glucagon_day_ug - jnp.sum(history.hours_ug, axis=0),
    )
    possible = jnp.where(jnp.isfinite(wanted_ug), wanted_ug, 0.0)
    return jnp.where(trusted, jnp.clip(possible, 0.0, jnp.maximum(left, 0.0)), 0.0)


def with_glucagon(history: GlucagonHistory, given_ug: jax.Array, sample_time_min: float) -> GlucagonHistory:
    """History after a sample at which an amount was asked for."""
    hours = jnp.concatenate([history.hours_ug[:-1], (history.hours_ug[-1] + given_ug)[None]])
    minutes = history.newest_min + sample_time_min
    over = minutes >= MIN_PER_H - 1e-6
    shifted = jnp.concatenate([hours[1:], jnp.zeros_like(hours[:1])])
    return GlucagonHistory(hours_ug=jnp.where(over, shifted, hours), newest_min=jnp.where(over, 0.0, minutes))


def repaired_glucagon(history: GlucagonHistory, settings: GuardSettings) -> GlucagonHistory:
    """History in which a number that is not possible is the cap of an hour, or an hour that begins."""
    hours, minutes = history.hours_ug, history.newest_min
    most = settings.max_glucagon_hour_ug
    return GlucagonHistory(
        hours_ug=jnp.where((hours >= 0.0) & (hours <= most), hours, most),
        newest_min=jnp.where((minutes >= 0.0) & (minutes < MIN_PER_H), minutes, 0.0),
    )
