"""Readings that a guard believes, and its estimate of glucose without them."""

from __future__ import annotations

import math
from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.control.guard_settings import GuardSettings

_TREND: Final = 0.5
"""Share of each change of the reading that counts as a trend; half of the noise of one reading is left."""
_FALLS: Final = 2.0
"""Factor on the believed rate of a fall relative to that of a rise, since doubting a fall is more dangerous."""
_FIRST_MG_DL: Final = 20.0
"""Distance from the setpoint up to which a first reading is believed at once. Of the readings below 70 mg/dl of an
integrated sensor more than 85 % must be right to 15 mg/dl (21 CFR 862.1355).
"""
_FORGET_MIN: Final = 60.0
"""Time constant with which the estimate of unseen glucose returns to the setpoint, as glucose does under the basal
rate.
"""
_NEVER_MG_DL: Final = 1e4
"""Distance from any reading that glucose cannot reach; it stands for no earlier reading."""
_TREND_MIN: Final = 15.0
"""Time constant with which a trend is assumed to end."""


@pytree
class Seen:
    """Knowledge of a guard about glucose."""

    glucose_mg_dl: jax.Array
    """Last believed reading, extrapolated since."""
    trend_mg_dl_min: jax.Array
    unseen_min: jax.Array
    """Time since a reading was believed."""
    reported_mg_dl: jax.Array
    """Last reading of all, believed or not."""
    same_min: jax.Array
    """Time for which the reading has been the same while insulin should have changed it."""
    unchanged_min: jax.Array
    """Time for which the reading has been the same."""
    jumped: jax.Array
    """Indicator, 1 if the last reading changed too fast to be believed, else 0."""
    awake: jax.Array
    """Indicator, 1 once a reading was believed, else 0."""


def first_seen(glucose_mg_dl: jax.Array, believed: jax.Array, setpoint_mg_dl: jax.Array) -> Seen:
    """State before the first reading is used; glucose is assumed at the setpoint if that is not believed."""
    zero = jnp.zeros_like(glucose_mg_dl)
    return Seen(
        glucose_mg_dl=jnp.where(believed, glucose_mg_dl, setpoint_mg_dl),
        trend_mg_dl_min=zero,
        unseen_min=zero,
        reported_mg_dl=zero - _NEVER_MG_DL,
        same_min=zero,
        unchanged_min=zero,
        jumped=zero,
        awake=zero,
    )


def heal_seen(seen: Seen, setpoint_mg_dl: jax.Array, settings: GuardSettings) -> Seen:
    """Start again, with no reading believed yet, where any number of the state is impossible."""
    glucose, trend, latest = seen.glucose_mg_dl, seen.trend_mg_dl_min, seen.reported_mg_dl
    sound = (glucose >= settings.lowest_reading_mg_dl) & (glucose <= settings.highest_reading_mg_dl)
    sound = sound & (jnp.abs(trend) <= _NEVER_MG_DL) & (jnp.abs(latest) <= _NEVER_MG_DL)
    for time in (seen.unseen_min, seen.same_min, seen.unchanged_min):
        sound = sound & (time >= 0.0) & (time < math.inf)
    for flag in (seen.jumped, seen.awake):
        sound = sound & ((flag == 0.0) | (flag == 1.0))
    fresh = first_seen(setpoint_mg_dl, jnp.zeros_like(sound), setpoint_mg_dl)
    healed: Seen = jax.tree.map(lambda value, anew: jnp.where(sound, value, anew), seen, fresh)
    return healed


def near(
    glucose_mg_dl: jax.Array, setpoint_mg_dl: jax.Array, settings: GuardSettings, sample_time_min: float
) -> jax.Array:
    """Whether a first reading needs no second one, being as near to the setpoint as the error allows."""
    most = jnp.maximum(_FIRST_MG_DL, settings.fastest_mg_dl_min * sample_time_min)
    return jnp.abs(glucose_mg_dl - setpoint_mg_dl) <= most


def possible(glucose_mg_dl: jax.Array, valid: jax.Array, settings: GuardSettings) -> jax.Array:
    """Whether a reading is a possible glucose; NaN is not."""
    within = (glucose_mg_dl >= settings.lowest_reading_mg_dl) & (glucose_mg_dl <= settings.highest_reading_mg_dl)
    return valid & within


def see(
    seen: Seen,
    glucose_mg_dl: jax.Array,
    valid: jax.Array,
    setpoint_mg_dl: jax.Array,
    pushed: jax.Array,
    settings: GuardSettings,
    sample_time_min: float,
) -> tuple[Seen, jax.Array, jax.Array]:
    """Include a reading or its absence.

    `pushed` says whether so much or so little insulin is on board that glucose must move. The answer is the knowledge
    after the sample, whether the reading is believed, and its jump if it is believed only because it stayed at the
    value that it jumped to.
    """
    is_possible = possible(glucose_mg_dl, valid, settings)
    change = glucose_mg_dl - seen.glucose_mg_dl
    since_min = seen.unseen_min + sample_time_min
    rate = jnp.where(change < 0.0, settings.fastest_mg_dl_min * _FALLS, settings.fastest_mg_dl_min)
    # There is nothing to hold a first reading to but the setpoint, and the next reading.
    again = jnp.abs(glucose_mg_dl - seen.reported_mg_dl) <= settings.fastest_mg_dl_min * sample_time_min
    first = again | near(glucose_mg_dl, setpoint_mg_dl, settings, sample_time_min)
    awake = seen.awake > 0.5
    slow = jnp.where(awake, jnp.abs(change) <= rate * since_min, first)
    same = is_possible & (glucose_mg_dl == seen.reported_mg_dl)
    same_min = jnp.where(same, seen.same_min + jnp.where(pushed, sample_time_min, 0.0), 0.0)
    # A low reading is believed even if it does not move: to give insulin on a guess would be worse.
    moving = (same_min < settings.stuck_min) | (glucose_mg_dl < settings.low_mg_dl)
    believed = is_possible & slow & moving

    # After a gap the change is not that of one sample; no trend is made of it.
    slope = jnp.where(seen.unseen_min == 0.0, change * (1.0 / sample_time_min), 0.0)
    trend = seen.trend_mg_dl_min + _TREND * (slope - seen.trend_mg_dl_min)
    back = 1.0 - math.exp(-sample_time_min / _FORGET_MIN)
    ahead = seen.glucose_mg_dl + back * (setpoint_mg_dl - seen.glucose_mg_dl) + sample_time_min * seen.trend_mg_dl_min
    ahead = jnp.clip(ahead, settings.lowest_reading_mg_dl, settings.highest_reading_mg_dl)
    fading = math.exp(-sample_time_min / _TREND_MIN) * seen.trend_mg_dl_min
    return (
        Seen(
            glucose_mg_dl=jnp.where(believed, glucose_mg_dl, ahead),
            trend_mg_dl_min=jnp.where(believed, trend, fading),
            unseen_min=jnp.where(believed, 0.0, since_min),
            reported_mg_dl=jnp.where(is_possible, glucose_mg_dl, seen.reported_mg_dl),
            same_min=jnp.where(is_possible, same_min, seen.same_min),
            unchanged_min=jnp.where(
                is_possible, jnp.where(same, seen.unchanged_min + sample_time_min, 0.0), seen.unchanged_min
            ),
            jumped=jnp.where(is_possible & awake, jnp.where(slow, 0.0, 1.0), seen.jumped),
            awake=jnp.where(believed, 1.0, seen.awake),
        ),
        believed,
        jnp.where(believed, seen.jumped * change, 0.0),
    )
