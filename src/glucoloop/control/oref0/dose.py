"""The temporary basal rate and the microbolus (``determine_basal`` of ``determine-basal.js``).

The original returns at the first condition that holds. Here each condition stands in a list with its answer, in the
order of the original, and the answer of the first that holds is taken.

Left out are ratios of autosens, noise and calibrations of the sensor, comparisons of the history of the pump with the
rate in force, the bolus wizard, and temporary basal rates that are skipped if neutral.
"""

from __future__ import annotations

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.control.oref0.forecast import Effects, Forecast, effects_now, forecast
from glucoloop.control.oref0.records import (
    DosingProfile,
    GlucoseStatus,
    InsulinOnBoard,
    MealData,
    Suggestion,
    TempBasal,
    rounded,
    whole,
)


@pytree
class _Situation:
    """Arguments of the decision and what follows from them."""

    glucose: GlucoseStatus
    temp: TempBasal
    iob: InsulinOnBoard
    meal: MealData
    profile: DosingProfile
    basal: jax.Array
    target_bg: jax.Array
    threshold: jax.Array
    now: Effects
    ahead: Forecast

    def set(self, rate: jax.Array | float, duration: jax.Array | float = 30.0) -> Suggestion:
        """Ask for a rate by ``setTempBasal``."""
        return _set_temp_basal(rate, duration, self.profile, self.temp)

    def neutral(self) -> Suggestion:
        """The basal rate, unless it runs for over 15 min."""
        runs = round_basal(self.basal, self.profile) == round_basal(self.temp.rate_U_h, self.profile)
        return _first([((self.temp.duration_min > 15.0) & runs, self.nothing())], self.set(self.basal))

    def nothing(self) -> Suggestion:
        """The rate in force goes on."""
        return _suggested(self.temp.rate_U_h, self.temp.duration_min, holds=False)

    def scheduled(self) -> jax.Array:
        """``insulinScheduled``: insulin above the basal rate that the rate in force will still give [U]."""
        return self.temp.duration_min * (self.temp.rate_U_h - self.basal) / 60.0

    def minutes_without(self, undershoot: jax.Array) -> jax.Array:
        """``durationReq``: minutes without the basal rate that raise glucose by so much."""
        return whole(60.0 * (undershoot / self.now.sens) / self.profile.current_basal_U_h)


def determine_basal(
    glucose: GlucoseStatus,
    temp: TempBasal,
    iob: InsulinOnBoard,
    meal: MealData,
    profile: DosingProfile,
    *,
    micro_bolus_allowed: jax.Array | bool = True,
) -> Suggestion:
    """Suggest a temporary basal rate and a microbolus; all arguments are of one person or of people ``(people,)``.

    Parameters
    ----------
    glucose, temp, iob, meal, profile
        The arguments of the original, see `records`.
    micro_bolus_allowed
        Whether the pump gives microboluses at all.
    """
    min_bg, max_bg = jnp.asarray(profile.min_bg_mg_dl), jnp.asarray(profile.max_bg_mg_dl)
    target_bg, threshold = (min_bg + max_bg) / 2.0, min_bg - 0.5 * (min_bg - 40.0)
    now = effects_now(glucose, iob, profile)
    ahead = forecast(glucose, iob, meal, profile, now, target_bg=target_bg, threshold=threshold)
    own_basal, ratio = jnp.asarray(profile.current_basal_U_h), now.sensitivity_ratio
    scheduled_basal = round_basal(own_basal, profile)
    basal = scheduled_basal if ratio is None else round_basal(own_basal * ratio, profile)
    seen = _Situation(
        glucose=glucose,
        temp=temp,
        iob=iob,
        meal=meal,
        profile=profile,
        basal=basal,
        target_bg=target_bg,
        threshold=threshold,
        now=now,
        ahead=ahead,
    )
    bg, falls_low = glucose.glucose_mg_dl, ahead.min_guard_bg < threshold
    max_delta = jnp.maximum(jnp.maximum(glucose.delta, glucose.short_avgdelta), glucose.long_avgdelta)
    sudden = max_delta > jnp.minimum(profile.max_delta_bg_threshold, 0.3) * bg
    smb = micro_bolus_allowed & _enable_smb(bg, meal, profile, target_bg) & ~falls_low & ~sudden
    expected = rounded(now.bgi + (target_bg - now.eventual_bg) / 24.0, 1)  # expectedDelta
    low, empty = bg < threshold, iob.iob_U < -jnp.asarray(profile.current_basal_U_h) * 20.0 / 60.0
    recovers = low & empty & (now.min_delta > 0.0) & (now.min_delta > expected)
    in_range = jnp.minimum(ahead.eventual_bg, ahead.min_pred_bg) < max_bg
    return _first(
        [
            (_unusable(glucose, profile), _without_reading(temp, scheduled_basal)),
            (~recovers & (low | falls_low), _suspend(seen)),
            (ahead.eventual_bg < min_bg, _lower(seen, expected)),
            (((now.min_delta < expected) | in_range) & ~smb, seen.neutral()),
            (iob.iob_U > profile.max_iob_U, seen.neutral()),
        ],
        _raise(seen, smb),
    )


def _enable_smb(bg: jax.Array, meal: MealData, profile: DosingProfile, target_bg: jax.Array) -> jax.Array:
    """``enable_smb``: whether a preference allows microboluses now."""
    enabled = (
        jnp.asarray(profile.enable_smb_always)
        | (profile.enable_smb_with_cob & (meal.meal_cob_g > 0.0))
        | (profile.enable_smb_after_carbs & (meal.carbs_g > 0.0))
        | (profile.enable_smb_high_bg & (bg >= profile.enable_smb_high_bg_target_mg_dl))
    )
    if profile.temptarget_set is False:
        return enabled
    set_now = jnp.asarray(profile.temptarget_set)
    enabled = enabled | (profile.enable_smb_with_temptarget & set_now & (target_bg < 100.0))
    return enabled & ~(set_now & (target_bg > 100.0) & ~jnp.asarray(profile.allow_smb_with_high_temptarget))


def _unusable(glucose: GlucoseStatus, profile: DosingProfile) -> jax.Array:
    """Whether the reading is a code of an error, too old, or has not changed for 40 min."""
    bg, age = glucose.glucose_mg_dl, rounded(glucose.minutes_ago, 1)
    bad = (bg <= 10.0) | (bg == 38.0) | (age > 12.0) | (age < -5.0)
    if not profile.flat_is_error:
        return bad
    flat = (jnp.abs(glucose.short_avgdelta) < 1.0) & (jnp.abs(glucose.long_avgdelta) < 1.0)
    return bad | ((bg > 60.0) & (glucose.delta == 0.0) & flat)


def _without_reading(temp: TempBasal, basal: jax.Array) -> Suggestion:
    """The basal rate in place of a higher one, and no rate of 0 for over 30 min."""
    return _first(
        [
            (temp.rate_U_h > basal, _suggested(basal, 30.0)),
            ((temp.rate_U_h == 0.0) & (temp.duration_min > 30.0), _suggested(jnp.zeros_like(basal), 30.0)),
        ],
        _suggested(temp.rate_U_h, temp.duration_min, holds=False),
    )


def _suspend(seen: _Situation) -> Suggestion:
    """Rate of 0 for 30 to 120 min, since glucose is low or will be."""
    minutes = whole(seen.minutes_without(seen.target_bg - seen.ahead.min_guard_bg) / 30.0) * 30.0
    return seen.set(0.0, jnp.clip(minutes, 30.0, 120.0))


def _lower(seen: _Situation, expected: jax.Array) -> Suggestion:
    """A rate below the basal rate, since glucose will end below the target."""
    now, ahead, temp, sens = seen.now, seen.ahead, seen.temp, seen.now.sens
    rises = (now.min_delta > expected) & (now.min_delta > 0.0) & (_carbs_required(seen) == 0.0)
    rising = _first([(now.naive_eventual_bg < 40.0, seen.set(0.0))], seen.neutral())
    required = rounded(2.0 * jnp.minimum(0.0, (ahead.eventual_bg - seen.target_bg) / sens), 2)
    naive = rounded(jnp.minimum(0.0, (now.naive_eventual_bg - seen.target_bg) / sens), 2)
    barely = (now.min_delta < 0.0) & (now.min_delta > expected)
    part = now.min_delta / jnp.where(barely, expected, 1.0)
    required = jnp.where(barely, rounded(required * part, 2), required)
    rate = round_basal(seen.basal + 2.0 * required, seen.profile)
    short = seen.scheduled() < jnp.minimum(required, naive) - seen.basal * 0.3
    runs = (temp.duration_min > 5.0) & (rate >= temp.rate_U_h * 0.8)
    minutes = whole(seen.minutes_without(seen.target_bg - now.naive_eventual_bg) / 30.0) * 30.0
    minutes = jnp.clip(minutes, 0.0, 120.0)
    return _first(
        [
            (rises, rising),
            (short, seen.set(rate)),
            (runs, seen.nothing()),
            ((rate <= 0.0) & (minutes > 0.0), seen.set(rate, minutes)),
        ],
        seen.set(rate),
    )


def _carbs_required(seen: _Situation) -> jax.Array:
    """``carbsReq``: carbohydrate that would keep glucose above the threshold [g]; below 0 where none is needed."""
    now, ahead, meal = seen.now, seen.ahead, seen.meal
    naive = now.naive_eventual_bg
    reached = jnp.where(naive < 40.0, jnp.minimum(ahead.min_guard_bg, naive), naive)
    by_zero_temp = seen.profile.current_basal_U_h * now.sens * ahead.minutes_above_threshold / 60.0
    on_board = jnp.maximum(0.0, meal.meal_cob_g - 0.25 * meal.carbs_g)
    return whole((seen.threshold - reached - by_zero_temp) / now.csf - on_board)


def _raise(seen: _Situation, smb: jax.Array) -> Suggestion:
    """A rate above the basal rate, or a microbolus and a low rate after it, since glucose will end above the target."""
    now, ahead, temp, iob, profile = seen.now, seen.ahead, seen.temp, seen.iob, seen.profile
    required = rounded((jnp.minimum(ahead.min_pred_bg, ahead.eventual_bg) - seen.target_bg) / now.sens, 2)
    required = jnp.minimum(required, profile.max_iob_U - iob.iob_U)
    rate = round_basal(seen.basal + 2.0 * required, profile)
    required = rounded(required, 3)
    smb = smb & (seen.glucose.glucose_mg_dl > seen.threshold)
    bolus, low_rate, minutes = _microbolus(seen, required)
    bolus = jnp.where(smb, bolus, 0.0)
    safe = _max_safe_basal(profile)
    rate = jnp.where(rate > safe, round_basal(safe, profile), rate)
    runs = (temp.duration_min > 5.0) & (round_basal(rate, profile) <= round_basal(temp.rate_U_h, profile))
    enough = seen.scheduled() < required * 2.0
    chosen = _first(
        [
            (smb & (minutes > 0.0), _suggested(low_rate, minutes)),
            (enough & runs, seen.nothing()),
        ],
        seen.set(rate),
    )
    return Suggestion(sets_temp=chosen.sets_temp, temp=chosen.temp, units_U=jnp.broadcast_to(bolus, rate.shape))


def _microbolus(seen: _Situation, required: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Microbolus [U], and the rate [U/h] and the minutes of a low rate that makes up for it."""
    iob, profile = seen.iob, seen.profile
    for_meal = rounded(seen.meal.meal_cob_g / profile.carb_ratio_g_U, 3)
    covered = (iob.iob_U > for_meal) & (iob.iob_U > 0.0)
    basal_minutes = jnp.where(covered, profile.max_uam_smb_basal_min, profile.max_smb_basal_min)
    most = rounded(profile.current_basal_U_h * basal_minutes / 60.0, 1)
    steps_per_U = 1.0 / jnp.asarray(profile.bolus_increment_U)
    bolus = jnp.floor(jnp.minimum(required / 2.0, most) * steps_per_U) / steps_per_U
    undershoot = seen.target_bg - (seen.now.naive_eventual_bg + seen.ahead.min_iob_pred_bg) / 2.0
    minutes = seen.minutes_without(undershoot)
    minutes = jnp.where((required > 0.0) & (bolus < profile.bolus_increment_U), 0.0, minutes)
    short = (minutes > 0.0) & (minutes < 30.0)
    low_rate = jnp.where(short, rounded(seen.basal * minutes / 30.0, 2), 0.0)
    long = jnp.clip(whole(minutes / 30.0) * 30.0, 0.0, 60.0)
    minutes = jnp.where(short, 30.0, jnp.where(minutes > 0.0, long, 0.0))
    waits = rounded(iob.last_bolus_age_min, 1) <= jnp.clip(profile.smb_interval_min, 1.0, 10.0)
    return jnp.where(waits | (bolus <= 0.0), 0.0, bolus), low_rate, minutes


def _first(cases: list[tuple[jax.Array, Suggestion]], otherwise: Suggestion) -> Suggestion:
    """The answer of the first condition that holds, person by person."""
    chosen = otherwise
    for holds, answer in reversed(cases):
        chosen = jax.tree.map(lambda mine, other, holds=holds: jnp.where(holds, mine, other), answer, chosen)
    return chosen


def round_basal(rate_U_h: jax.Array, profile: DosingProfile) -> jax.Array:
    """A rate in the steps of a pump: 0.05 U/h below 10 U/h, or finer below 1 U/h, and 0.1 U/h above."""
    scale = jnp.where(rate_U_h < 1.0, float(profile.steps_per_U_h), jnp.where(rate_U_h < 10.0, 20.0, 10.0))
    return whole(rate_U_h * scale) / scale


def _max_safe_basal(profile: DosingProfile) -> jax.Array:
    """``getMaxSafeBasal``: the largest temporary basal rate [U/h]."""
    by_day = profile.max_daily_safety_multiplier * jnp.asarray(profile.max_daily_basal_U_h)
    now = profile.current_basal_safety_multiplier * jnp.asarray(profile.current_basal_U_h)
    return jnp.minimum(profile.max_basal_U_h, jnp.minimum(by_day, now))


def _set_temp_basal(
    rate_U_h: jax.Array | float, duration_min: jax.Array | float, profile: DosingProfile, temp: TempBasal
) -> Suggestion:
    """``setTempBasal``: a rate within the limits, unless one within 20 % of it runs long enough."""
    rate = round_basal(jnp.clip(rate_U_h, 0.0, _max_safe_basal(profile)), profile)
    left, running = temp.duration_min, temp.rate_U_h
    lasts = (left > duration_min - 10.0) & (left <= 120.0)
    alike = (rate <= running * 1.2) & (rate >= running * 0.8)
    return _suggested(rate, duration_min, ~(lasts & alike & (jnp.asarray(duration_min) > 0.0)))


def _suggested(rate_U_h: jax.Array, duration_min: jax.Array | float, holds: jax.Array | bool = True) -> Suggestion:
    """A rate as it is, where it is asked for."""
    rate, duration, holds = jnp.broadcast_arrays(
        rate_U_h, jnp.asarray(duration_min, jnp.asarray(rate_U_h).dtype), holds
    )
    return Suggestion(
        sets_temp=holds,
        temp=TempBasal(rate_U_h=rate, duration_min=duration),
        units_U=jnp.zeros_like(rate),
    )
