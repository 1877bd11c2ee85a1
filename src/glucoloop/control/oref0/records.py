"""Arguments and result of ``determine_basal``, each under its name in oref0, with units; and its rounding.

Numbers are rounded as JavaScript does it, since oref0 rounds at many places and a dose can hang on one.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static


@pytree
class GlucoseStatus:
    """``glucose_status``: the last reading and how fast glucose changes."""

    glucose_mg_dl: jax.Array
    delta: jax.Array
    """Change over the last 5 min [mg/dl/5 min]."""
    short_avgdelta: jax.Array
    """Mean change since the readings 5 to 15 min ago [mg/dl/5 min]."""
    long_avgdelta: jax.Array
    """Mean change since the readings 20 to 40 min ago [mg/dl/5 min]."""
    minutes_ago: jax.Array
    """Age of the reading [min]."""


@pytree
class TempBasal:
    """``currenttemp``: the temporary basal rate in force; both are 0 without one."""

    rate_U_h: jax.Array
    duration_min: jax.Array
    """Time for which it still runs."""


@pytree
class InsulinOnBoard:
    """``iob_data``: insulin on board above the basal rate, and its activity now and every 5 min ahead ``(ticks,)``.

    Without ticks no glucose is predicted, as where oref0 is given the insulin on board of this moment alone.
    """

    iob_U: jax.Array
    activity_U_min: jax.Array
    """Insulin activity of this moment."""
    ahead_U_min: jax.Array
    """Activity of each tick, of which the first is now."""
    zero_temp_ahead_U_min: jax.Array
    """Activity of each tick if no basal insulin is given from now on."""
    last_bolus_age_min: jax.Array
    """Time since the last bolus."""


@pytree
class MealData:
    """``meal_data``: carbohydrate that was announced, and what is still to appear."""

    carbs_g: jax.Array
    """Carbohydrate of meals that still count."""
    meal_cob_g: jax.Array
    """Carbohydrate on board."""
    slope_from_max_deviation: jax.Array
    """Change of the deviation since its largest value of half an hour, at most 0 [mg/dl/5 min per 5 min]."""
    slope_from_min_deviation: jax.Array
    """Change of the deviation since its minimum value of half an hour, at least 0 [mg/dl/5 min per 5 min]."""
    last_carb_age_min: jax.Array
    """Time since the last meal; any number without one."""


NORMAL_TARGET: Final = 100.0
"""Target by which a temporary one is high or low, whatever the schedule has."""


@pytree
class DosingProfile:
    """``profile``: what is known of the person, and the preferences with their defaults of ``profile/index.js``."""

    current_basal_U_h: jax.Array | float
    max_daily_basal_U_h: jax.Array | float
    """Largest basal rate of the day."""
    max_basal_U_h: jax.Array | float
    """Largest temporary basal rate of the pump."""
    sens_mg_dl_U: jax.Array | float
    """Fall of glucose by 1 U."""
    carb_ratio_g_U: jax.Array | float
    min_bg_mg_dl: jax.Array | float
    max_bg_mg_dl: jax.Array | float
    max_iob_U: jax.Array | float = 0.0
    temptarget_set: jax.Array | bool = False
    """Whether the target is a temporary one."""
    max_daily_safety_multiplier: jax.Array | float = 3.0
    current_basal_safety_multiplier: jax.Array | float = 4.0
    enable_uam: jax.Array | bool = True
    enable_smb_always: jax.Array | bool = False
    enable_smb_with_cob: jax.Array | bool = False
    enable_smb_after_carbs: jax.Array | bool = False
    enable_smb_high_bg: jax.Array | bool = False
    enable_smb_high_bg_target_mg_dl: jax.Array | float = 110.0
    max_smb_basal_min: jax.Array | float = 30.0
    max_uam_smb_basal_min: jax.Array | float = 30.0
    allow_smb_with_high_temptarget: jax.Array | bool = False
    enable_smb_with_temptarget: jax.Array | bool = False
    high_temptarget_raises_sensitivity: jax.Array | bool = False
    low_temptarget_lowers_sensitivity: jax.Array | bool = False
    exercise_mode: jax.Array | bool = False
    """``high_temptarget_raises_sensitivity``, and less basal rate in the history of temporary rates."""
    half_basal_exercise_target_mg_dl: jax.Array | float = 160.0
    autosens_max: jax.Array | float = 1.2
    smb_interval_min: jax.Array | float = 3.0
    bolus_increment_U: jax.Array | float = 0.1
    max_delta_bg_threshold: jax.Array | float = 0.2
    min_5m_carbimpact: jax.Array | float = 8.0
    """Minimum appearance of carbohydrate on board that is taken for granted [mg/dl/5 min]."""
    max_cob_g: jax.Array | float = 120.0
    remaining_carbs_fraction: jax.Array | float = 1.0
    remaining_carbs_cap_g: jax.Array | float = 90.0
    steps_per_U_h: int = static(default=20)
    """``lowest_rate_scale``: steps of a rate below 1 U/h; 40 for the pumps x23 and x54."""
    flat_is_error: bool = static(default=True)
    """Whether a reading that has not changed for 40 min is an error of the sensor; not with ``fakecgm``."""


@pytree
class Suggestion:
    """``rT``: the temporary basal rate that is asked for, if any, and the microbolus."""

    sets_temp: jax.Array
    """Whether a temporary basal rate is asked for; if not, the one in force goes on."""
    temp: TempBasal
    units_U: jax.Array
    """Microbolus; 0 for none."""


def whole(value: jax.Array) -> jax.Array:
    """``Math.round``: the nearest whole number, of two the larger."""
    below = jnp.floor(value)
    return jnp.where(value >= below + 0.5, below + 1.0, below)


def rounded(value: jax.Array, digits: int) -> jax.Array:
    """A number to decimal places, as ``round`` of ``determine-basal.js``."""
    scale = 10.0**digits
    return whole(value * scale) / scale


def fixed(value: jax.Array) -> jax.Array:
    """``toFixed(2)``: two decimal places, of two the one that is farther from zero."""
    return jnp.sign(value) * rounded(jnp.abs(value), 2)


def numbered(count: int, like: jax.Array, first: int = 0) -> jax.Array:
    """Whole numbers ``(count,)`` that go with people ``(people,)``, in their precision."""
    numbers = jnp.arange(first, first + count, dtype=like.dtype)
    return numbers.reshape((count,) + (1,) * like.ndim)
