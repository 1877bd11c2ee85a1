"""Carbohydrate on board, by what glucose did beside insulin (``determine-basal/cob.js``, ``meal/total.js``).

The deviation of a reading is its change less the change that insulin on board explains. Since a meal, each deviation
is carbohydrate that was absorbed, of which at least ``min_5m_carbimpact`` is taken for granted.

In two things this is not the original. Across a gap between readings it leaves out the older one of the two, so that
all that is older moves by 5 min; here all stays in place. And where it looks at a second meal, or at the slopes, it
forgets insulin that is newer than the oldest reading of the meal before; here none is forgotten.
"""

from __future__ import annotations

from typing import Final, TypeAlias

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.control.oref0.records import DosingProfile, MealData
from glucoloop.control.oref0.rounding import fixed, numbered, rounded, whole

MEALS: Final = 72
"""Samples of six hours, the time for which a meal counts."""
DEVIATIONS: Final = MEALS - 2
"""Deviations of that time. The original looks at none of the first two samples of a meal."""
_SLOPES: Final = 7
"""Mean deviations of half an hour, between which a slope is looked for."""
_AVERAGED: Final = 3
"""Samples of a mean change."""
_SAMPLES_PER_H: Final = 12
_MIN_CARBS_G: Final = 1.0
_Fold: TypeAlias = "tuple[jax.Array, jax.Array, jax.Array, jax.Array]"
"""Carbohydrate so far, the largest that is on board, what is older and not, and what was absorbed [g]."""


@pytree
class CarbAbsorption:
    """Result of ``detectCarbAbsorption``."""

    absorbed_g: jax.Array
    """Carbohydrate that was absorbed from one sample to the next ``(meals,)``, and none at the newest two."""
    slope_from_max_deviation: jax.Array
    slope_from_min_deviation: jax.Array


def bucketed(glucose_mg_dl: jax.Array, new_mg_dl: jax.Array, gap: jax.Array) -> jax.Array:
    """Glucose every 5 min with a new reading at its head, and a line across the samples without one before it.

    `gap` is the number of samples since the reading before; between, `glucose_mg_dl` holds that reading.
    """
    row = jnp.concatenate([new_mg_dl[None], glucose_mg_dl[:-1]])
    number = numbered(len(row), new_mg_dl)
    line = whole(new_mg_dl + (glucose_mg_dl[0] - new_mg_dl) * (number / gap))
    return jnp.where((number > 0.0) & (number < gap), line, row)


def detect_carb_absorption(
    glucose_mg_dl: jax.Array, activity_U_min: jax.Array, profile: DosingProfile
) -> CarbAbsorption:
    """Absorption at each sample, from glucose ``(deviations + 1,)`` and activity ``(deviations,)``, newest first."""
    sens = jnp.asarray(profile.sens_mg_dl_U)
    bgi = rounded(-activity_U_min * sens * 5.0, 2)
    deviation = fixed(glucose_mg_dl[:-1] - glucose_mg_dl[1:] - bgi)
    mean = fixed((glucose_mg_dl[:_SLOPES] - glucose_mg_dl[_AVERAGED : _SLOPES + _AVERAGED]) / 3.0)
    mean_deviation = rounded(mean - bgi[:_SLOPES], 3)
    current = mean_deviation[0]
    impact = jnp.maximum(jnp.maximum(deviation, current / 2.0), profile.min_5m_carbimpact)
    absorbed = impact * profile.carb_ratio_g_U / sens
    largest, least = jnp.zeros_like(current), jnp.full_like(current, 999.0)
    from_max, from_min = jnp.zeros_like(current), jnp.full_like(current, 999.0)
    for i in range(1, _SLOPES):
        then = mean_deviation[i]
        slope = (then - current) / (-300_000.0 * i) * 1000.0 * 60.0 * 5.0
        from_max = jnp.where(then > largest, jnp.minimum(0.0, slope), from_max)
        from_min = jnp.where(then < least, jnp.maximum(0.0, slope), from_min)
        largest, least = jnp.maximum(largest, then), jnp.minimum(least, then)
    return CarbAbsorption(
        absorbed_g=jnp.concatenate([jnp.zeros_like(absorbed[:2]), absorbed]),
        slope_from_max_deviation=from_max,
        slope_from_min_deviation=from_min,
    )


def recent_carbs(
    carbs_g: jax.Array, glucose_mg_dl: jax.Array, activity_U_min: jax.Array, profile: DosingProfile
) -> MealData:
    """``recentCarbs``: meals of the last six hours, from carbohydrate announced at each sample ``(meals,)``.

    A meal that raises carbohydrate on board, with all that was eaten after it, counts; older ones do not.
    """
    result = detect_carb_absorption(glucose_mg_dl, activity_U_min, profile)
    zero = jnp.zeros_like(carbs_g[0])

    def sample(carry: _Fold, row: tuple[jax.Array, jax.Array]) -> tuple[_Fold, None]:
        carbs, on_board, removed, absorbed = carry
        eaten, absorbed = row[0], absorbed + row[1]
        counts = eaten >= _MIN_CARBS_G
        carbs = carbs + jnp.where(counts, eaten, 0.0)
        own = jnp.maximum(0.0, carbs - absorbed)
        on_board = jnp.where(counts, jnp.maximum(on_board, own), on_board)
        removed = jnp.where(counts, jnp.where(own < on_board, removed + eaten, 0.0), removed)
        return (carbs, on_board, removed, absorbed), None

    def hour(carry: _Fold, rows: tuple[jax.Array, jax.Array]) -> tuple[_Fold, None]:
        return jax.lax.scan(sample, carry, rows)

    # Hour by hour, since native code takes no loop of over 64 rounds.
    by_hour = jax.tree.map(lambda row: row.reshape(-1, _SAMPLES_PER_H, *zero.shape), (carbs_g, result.absorbed_g))
    (carbs, on_board, removed, _), _ = jax.lax.scan(hour, (zero, zero, zero, zero), by_hour)
    age = 5.0 * numbered(MEALS, zero)
    return MealData(
        carbs_g=rounded(carbs - removed, 3),
        meal_cob_g=whole(jnp.minimum(profile.max_cob_g, on_board)),
        slope_from_max_deviation=rounded(result.slope_from_max_deviation, 3),
        slope_from_min_deviation=rounded(result.slope_from_min_deviation, 3),
        last_carb_age_min=jnp.min(jnp.where(carbs_g >= _MIN_CARBS_G, age, 5.0 * MEALS), axis=0),
    )
