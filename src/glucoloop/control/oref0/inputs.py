"""Inputs of a dose of oref0: the change of glucose, insulin on board and carbohydrate on board, from histories.

Glucose is that of ``glucose-get-last.js``, insulin on board that of ``iob/calculate.js`` and ``iob/total.js``, and
carbohydrate on board that of ``determine-basal/cob.js`` and ``meal/total.js``.

With the peak ``tp`` and the end ``td`` of insulin action, after L. Maksimovic (LoopKit/Loop, discussion 388)::

    tau = tp (1 - tp/td) / (1 - 2 tp/td),   a = 2 tau/td,   S = 1 / (1 - a + (1 + a) exp(-td/tau))
    activity(t) = S/tau^2 t (1 - t/td) exp(-t/tau)
    IOB(t) = 1 - S (1 - a) ((t^2 / (tau td (1 - a)) - t/tau - 1) exp(-t/tau) + 1)

The original cuts the insulin of temporary basal rates into pulses of 0.05 U (``iob/history.js``). Here the insulin that
the pump reports for a sample, less the basal rate, is one treatment at the start of that sample.

The deviation of a reading is its change less the change that insulin on board explains. Since a meal, each deviation
is carbohydrate that was absorbed, of which at least ``min_5m_carbimpact`` is taken for granted.

In two things this is not the original. Across a gap between readings it leaves out the older one of the two, so that
all that is older moves by 5 min; here all stays in place. And where it looks at a second meal, or at the slopes, it
forgets insulin that is newer than the oldest reading of the meal before; here none is forgotten.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop.control.oref0.records import (
    NORMAL_TARGET,
    DosingProfile,
    GlucoseStatus,
    InsulinOnBoard,
    MealData,
    fixed,
    numbered,
    rounded,
    whole,
)

_LAST_MIN: Final = 5.0
"""Time between two readings."""
_SHORT, _LONG = (1, 2, 3), (4, 5, 6, 7, 8)
"""Readings of the short and the long average, 5 to 15 and 20 to 40 min before the last one."""
_OLDEST: Final = 2
"""Samples after which the last reading is too old to dose by; rates of change do not matter then."""
READINGS: Final = _OLDEST + _LONG[-1] + 1
"""Number of readings that are looked at."""
_MIN_MG_DL: Final = 38.0


def glucose_get_last(readings_mg_dl: jax.Array) -> GlucoseStatus:
    """Status of glucose from readings every 5 min ``(readings,)``, of which the first is now; 0 where there is none."""
    known = readings_mg_dl > 0.0
    age = jnp.where(known[0], 0, jnp.where(known[1], 1, _OLDEST))
    row = readings_mg_dl[_OLDEST:]
    for late in range(_OLDEST - 1, -1, -1):
        row = jnp.where(age == late, readings_mg_dl[late : READINGS - _OLDEST + late], row)
    minutes_ago = jnp.where(jnp.any(known[: _OLDEST + 1], axis=0), _LAST_MIN * age, 1e3)

    def mean(which: tuple[int, ...]) -> jax.Array:
        total = count = jnp.zeros_like(row[0])
        for i in which:
            there = row[i] > _MIN_MG_DL
            total = total + jnp.where(there, (row[0] - row[i]) / (_LAST_MIN * i) * 5.0, 0.0)
            count = count + there
        return rounded(total / jnp.maximum(count, 1.0), 2)

    return GlucoseStatus(
        glucose_mg_dl=rounded(row[0], 2),
        delta=mean(_SHORT[:1]),
        short_avgdelta=mean(_SHORT),
        long_avgdelta=mean(_LONG),
        minutes_ago=minutes_ago,
    )


SAMPLE_MIN: Final = 5
TICKS: Final = 48
"""Number of points of 5 min for which activity is predicted, four hours."""
PEAKS_MIN: Final = {"rapid-acting": 75.0, "ultra-rapid": 55.0}
"""Time of the peak by kind of insulin."""
Floats: TypeAlias = "npt.NDArray[np.float64]"


def treatments(dia_h: float) -> int:
    """Number of samples of which insulin is still at work, this one included."""
    return math.ceil(dia_h * 60.0 / SAMPLE_MIN)


def insulin_curve(minutes: Floats, dia_h: float, peak_min: float) -> tuple[Floats, Floats]:
    """Insulin on board [U] and activity [U/min] of 1 U, some minutes after it was given; 0 from the end on."""
    end, t = 60.0 * dia_h, minutes
    tau = peak_min * (1.0 - peak_min / end) / (1.0 - 2.0 * peak_min / end)
    a = 2.0 * tau / end
    S = 1.0 / (1.0 - a + (1.0 + a) * math.exp(-end / tau))
    fades = np.exp(-t / tau)
    activity = S / tau**2 * t * (1.0 - t / end) * fades
    on_board = 1.0 - S * (1.0 - a) * ((t**2 / (tau * end * (1.0 - a)) - t / tau - 1.0) * fades + 1.0)
    return np.where(t < end, on_board, 0.0), np.where(t < end, activity, 0.0)


def iob_total(
    insulin_U: jax.Array,
    current_basal_U_h: jax.Array | float,
    last_bolus_age_min: jax.Array,
    *,
    dia_h: float,
    peak_min: float,
) -> InsulinOnBoard:
    """Insulin on board of treatments ``(treatments,)`` every 5 min, of which the first is now and the last the oldest.

    Activity is predicted for insulin that was given, and for no basal insulin from now on (``iobWithZeroTemp``).
    """
    count = treatments(dia_h)
    on_board, activity = insulin_curve(SAMPLE_MIN * np.arange(count + TICKS, dtype=float), dia_h, peak_min)
    ahead = activity[np.arange(TICKS)[:, None] + np.arange(count)]
    # A sample without basal insulin begins now and at each tick before the one that is looked at.
    missing = np.r_[0.0, np.cumsum(activity[1:TICKS])]
    basal = jnp.asarray(current_basal_U_h) * (SAMPLE_MIN / 60.0)
    given = _summed(ahead, insulin_U)
    by_basal = jnp.asarray(missing, insulin_U.dtype).reshape((TICKS,) + (1,) * (given.ndim - 1))
    given, without = rounded(given, 4), rounded(given - by_basal * basal, 4)
    return InsulinOnBoard(
        iob_U=rounded(_summed(on_board[:count], insulin_U), 3),
        activity_U_min=given[0],
        ahead_U_min=given,
        zero_temp_ahead_U_min=without,
        last_bolus_age_min=last_bolus_age_min,
    )


_LEAST_ABOVE: Final = 5.0


def exercise_share(profile: DosingProfile) -> jax.Array:
    """Share of the basal rate against which ``iob/history.js`` counts temporary rates: below 1 in ``exercise_mode``.

    With the temporary target T, at least 105 mg/dl, and the target H at which the basal rate is halved it is
    ``(H - 100) / (H - 100 + T - 100)``, for all temporary rates of the history.
    """
    target = (jnp.asarray(profile.min_bg_mg_dl) + jnp.asarray(profile.max_bg_mg_dl)) / 2.0
    half = profile.half_basal_exercise_target_mg_dl - NORMAL_TARGET
    holds = jnp.asarray(profile.exercise_mode) & profile.temptarget_set & (target >= NORMAL_TARGET + _LEAST_ABOVE)
    return jnp.where(holds, half / (half + jnp.maximum(target - NORMAL_TARGET, 0.0)), 1.0)


def _summed(weights: Floats, insulin_U: jax.Array) -> jax.Array:
    """Sums over treatments, weighted; constants have the precision of the insulin."""
    return jnp.tensordot(jnp.asarray(weights, insulin_U.dtype), insulin_U, 1)


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
class _CarbAbsorption:
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
) -> _CarbAbsorption:
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
    return _CarbAbsorption(
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
