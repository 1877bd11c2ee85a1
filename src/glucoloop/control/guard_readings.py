"""Readings that a guard accepts, and its estimate of glucose without them."""

from __future__ import annotations

import math
from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.control.guard_settings import GuardSettings

_TREND: Final = 0.5
"""Share of each change of the reading that counts as a trend; half of the noise of one reading is left."""
_FALLS: Final = 2.0
"""Factor on the accepted rate of a fall relative to that of a rise, since rejecting a fall is more dangerous."""
_FIRST_MG_DL: Final = 20.0
"""Distance from the setpoint up to which a first reading is accepted at once. Of the readings below 70 mg/dl of an
integrated sensor more than 85 % must be right to 15 mg/dl (21 CFR 862.1355).
"""
_FORGET_MIN: Final = 60.0
"""Time constant with which the estimate of glucose without accepted readings returns to the setpoint, as glucose does
under the basal rate.
"""
_NEVER_MG_DL: Final = 1e4
"""Distance from any reading that glucose cannot reach; it stands for no earlier reading."""
_TREND_MIN: Final = 15.0
"""Time constant with which a trend is assumed to end."""


@pytree
class ReadingHistory:
    """Past readings of a guard, and its estimate of glucose."""

    glucose_mg_dl: jax.Array
    """Last accepted reading, extrapolated since."""
    trend_mg_dl_min: jax.Array
    since_accepted_min: jax.Array
    """Time since a reading was accepted."""
    reported_mg_dl: jax.Array
    """Last reading of all, accepted or rejected."""
    same_min: jax.Array
    """Time for which the reading has been the same while insulin should have changed it."""
    unchanged_min: jax.Array
    """Time for which the reading has been the same."""
    jumped: jax.Array
    """Indicator, 1 if the last reading changed too fast to be accepted, else 0."""
    initialised: jax.Array
    """Indicator, 1 once a reading was accepted, else 0."""


def initial_readings(glucose_mg_dl: jax.Array, accepted: jax.Array, setpoint_mg_dl: jax.Array) -> ReadingHistory:
    """State before the first reading is used; glucose is assumed at the setpoint if that is not accepted."""
    zero = jnp.zeros_like(glucose_mg_dl)
    return ReadingHistory(
        glucose_mg_dl=jnp.where(accepted, glucose_mg_dl, setpoint_mg_dl),
        trend_mg_dl_min=zero,
        since_accepted_min=zero,
        reported_mg_dl=zero - _NEVER_MG_DL,
        same_min=zero,
        unchanged_min=zero,
        jumped=zero,
        initialised=zero,
    )


def repaired_readings(readings: ReadingHistory, setpoint_mg_dl: jax.Array, settings: GuardSettings) -> ReadingHistory:
    """Start again, with no reading accepted yet, where any number of the state is impossible."""
    glucose, trend, latest = readings.glucose_mg_dl, readings.trend_mg_dl_min, readings.reported_mg_dl
    sound = (glucose >= settings.lowest_reading_mg_dl) & (glucose <= settings.highest_reading_mg_dl)
    sound = sound & (jnp.abs(trend) <= _NEVER_MG_DL) & (jnp.abs(latest) <= _NEVER_MG_DL)
    for time in (readings.since_accepted_min, readings.same_min, readings.unchanged_min):
        sound = sound & (time >= 0.0) & (time < math.inf)
    for flag in (readings.jumped, readings.initialised):
        sound = sound & ((flag == 0.0) | (flag == 1.0))
    fresh = initial_readings(setpoint_mg_dl, jnp.zeros_like(sound), setpoint_mg_dl)
    repaired: ReadingHistory = jax.tree.map(lambda value, fresh: jnp.where(sound, value, fresh), readings, fresh)
    return repaired


def near(
    glucose_mg_dl: jax.Array, setpoint_mg_dl: jax.Array, settings: GuardSettings, sample_time_min: float
) -> jax.Array:
    """Whether a first reading needs no second one, being as near to the setpoint as the error allows."""
    largest_allowed_rate = jnp.maximum(_FIRST_MG_DL, settings.fastest_mg_dl_min * sample_time_min)
    return jnp.abs(glucose_mg_dl - setpoint_mg_dl) <= largest_allowed_rate


def possible(glucose_mg_dl: jax.Array, valid: jax.Array, settings: GuardSettings) -> jax.Array:
    """Whether a reading is a possible glucose; NaN is not."""
    within = (glucose_mg_dl >= settings.lowest_reading_mg_dl) & (glucose_mg_dl <= settings.highest_reading_mg_dl)
    return valid & within


def updated_readings(
    readings: ReadingHistory,
    glucose_mg_dl: jax.Array,
    valid: jax.Array,
    setpoint_mg_dl: jax.Array,
    pushed: jax.Array,
    settings: GuardSettings,
    sample_time_min: float,
) -> tuple[ReadingHistory, jax.Array, jax.Array]:
    """Include a reading or its absence.

    `pushed` says whether so much or so little insulin is on board that glucose must move. The result is the history
    after the sample, whether the reading is accepted, and its jump if it is accepted only because it stayed at the
    value that it jumped to.
    """
    is_possible = possible(glucose_mg_dl, valid, settings)
    change = glucose_mg_dl - readings.glucose_mg_dl
    since_min = readings.since_accepted_min + sample_time_min
    rate = jnp.where(change < 0.0, settings.fastest_mg_dl_min * _FALLS, settings.fastest_mg_dl_min)
    # There is nothing to hold a first reading to but the setpoint, and the next reading.
    again = jnp.abs(glucose_mg_dl - readings.reported_mg_dl) <= settings.fastest_mg_dl_min * sample_time_min
    first = again | near(glucose_mg_dl, setpoint_mg_dl, settings, sample_time_min)
    initialised = readings.initialised > 0.5
    slow = jnp.where(initialised, jnp.abs(change) <= rate * since_min, first)
    same = is_possible & (glucose_mg_dl == readings.reported_mg_dl)
    same_min = jnp.where(same, readings.same_min + jnp.where(pushed, sample_time_min, 0.0), 0.0)
    # A low reading is accepted even if it does not move: to give insulin on a guess would be worse.
    moving = (same_min < settings.stuck_min) | (glucose_mg_dl < settings.low_mg_dl)
    accepted = is_possible & slow & moving

    # After a gap the change is not that of one sample; no trend is made of it.
    slope = jnp.where(readings.since_accepted_min == 0.0, change * (1.0 / sample_time_min), 0.0)
    trend = readings.trend_mg_dl_min + _TREND * (slope - readings.trend_mg_dl_min)
    back = 1.0 - math.exp(-sample_time_min / _FORGET_MIN)
    ahead = (
        readings.glucose_mg_dl
        + back * (setpoint_mg_dl - readings.glucose_mg_dl)
        + sample_time_min * readings.trend_mg_dl_min
    )
    ahead = jnp.clip(ahead, settings.lowest_reading_mg_dl, settings.highest_reading_mg_dl)
    fading = math.exp(-sample_time_min / _TREND_MIN) * readings.trend_mg_dl_min
    return (
        ReadingHistory(
            glucose_mg_dl=jnp.where(accepted, glucose_mg_dl, ahead),
            trend_mg_dl_min=jnp.where(accepted, trend, fading),
            since_accepted_min=jnp.where(accepted, 0.0, since_min),
            reported_mg_dl=jnp.where(is_possible, glucose_mg_dl, readings.reported_mg_dl),
            same_min=jnp.where(is_possible, same_min, readings.same_min),
            unchanged_min=jnp.where(
                is_possible, jnp.where(same, readings.unchanged_min + sample_time_min, 0.0), readings.unchanged_min
            ),
            jumped=jnp.where(is_possible & initialised, jnp.where(slow, 0.0, 1.0), readings.jumped),
            initialised=jnp.where(accepted, 1.0, readings.initialised),
        ),
        accepted,
        jnp.where(accepted, readings.jumped * change, 0.0),
    )
