"""Limits and steps of a temporary basal rate (``basal-set-temp.js``, ``round-basal.js``)."""

from __future__ import annotations

from glucoloop._lazy_jax import jax, jnp
from glucoloop.control.oref0.records import DosingProfile, Suggestion, TempBasal
from glucoloop.control.oref0.rounding import whole


def round_basal(rate_U_h: jax.Array, profile: DosingProfile) -> jax.Array:
    """A rate in the steps of a pump: 0.05 U/h below 10 U/h, or finer below 1 U/h, and 0.1 U/h above."""
    scale = jnp.where(rate_U_h < 1.0, float(profile.steps_per_U_h), jnp.where(rate_U_h < 10.0, 20.0, 10.0))
    return whole(rate_U_h * scale) / scale


def max_safe_basal(profile: DosingProfile) -> jax.Array:
    """``getMaxSafeBasal``: the largest temporary basal rate [U/h]."""
    by_day = profile.max_daily_safety_multiplier * jnp.asarray(profile.max_daily_basal_U_h)
    now = profile.current_basal_safety_multiplier * jnp.asarray(profile.current_basal_U_h)
    return jnp.minimum(profile.max_basal_U_h, jnp.minimum(by_day, now))


def set_temp_basal(
    rate_U_h: jax.Array | float, duration_min: jax.Array | float, profile: DosingProfile, temp: TempBasal
) -> Suggestion:
    """``setTempBasal``: a rate within the limits, unless one within 20 % of it runs long enough."""
    rate = round_basal(jnp.clip(rate_U_h, 0.0, max_safe_basal(profile)), profile)
    left, running = temp.duration_min, temp.rate_U_h
    lasts = (left > duration_min - 10.0) & (left <= 120.0)
    alike = (rate <= running * 1.2) & (rate >= running * 0.8)
    return suggested(rate, duration_min, ~(lasts & alike & (jnp.asarray(duration_min) > 0.0)))


def suggested(rate_U_h: jax.Array, duration_min: jax.Array | float, holds: jax.Array | bool = True) -> Suggestion:
    """A rate as it is, where it is asked for."""
    rate, duration, holds = jnp.broadcast_arrays(
        rate_U_h, jnp.asarray(duration_min, jnp.asarray(rate_U_h).dtype), holds
    )
    return Suggestion(
        sets_temp=holds,
        temp=TempBasal(rate_U_h=rate, duration_min=duration),
        units_U=jnp.zeros_like(rate),
    )
