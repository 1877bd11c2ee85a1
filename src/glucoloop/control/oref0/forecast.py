"""Predicted glucose of the next four hours (``predBGs`` of ``determine-basal.js``) and what dosing takes from it.

Four lines start from the last reading. Insulin on board lowers each by its activity, and beside it

=====  ==================================================================================================
IOB    the deviation that glucose shows now fades to nothing within an hour
COB    carbohydrate on board appears as fast as now, slower and slower, and the rest in a triangle
UAM    glucose that nobody announced appears as fast as now, and falls at a third of the rate at which it
       rose, or to nothing within three hours
ZT     nothing; no basal insulin is given from now on
=====  ==================================================================================================
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.control.oref0.records import (
    NORMAL_TARGET,
    DosingProfile,
    GlucoseStatus,
    InsulinOnBoard,
    MealData,
    numbered,
    rounded,
    whole,
)

_NONE: Final = 999.0
"""Minimum predicted glucose where there is none."""
_LOWEST, _HIGHEST = 39.0, 401.0
_KEPT: Final = 48
"""Points of a line, the reading included."""
_INSULIN_PEAK, _UAM_WAIT = 18, 12
"""Points after which the minimum glucose counts, 90 min and 60 min."""
_MAX_ABSORPTION_G_H, _ASSUMED_ABSORPTION_G_H, _MIN_ABSORPTION_H = 30.0, 20.0, 3.0


@pytree
class Effects:
    """Effects of insulin and of glucose that appears, now."""

    sens: jax.Array
    """Fall of glucose by 1 U, rounded [mg/dl/U]."""
    csf: jax.Array
    """``csf``: rise of glucose by 1 g [mg/dl/g]."""
    bgi: jax.Array
    """Change of glucose by insulin [mg/dl/5 min]."""
    min_delta: jax.Array
    naive_eventual_bg: jax.Array
    """Glucose once insulin on board has acted, and nothing else."""
    eventual_bg: jax.Array
    """The same with the deviation of now for half an hour."""
    sensitivity_ratio: jax.Array | None = None
    """``sensitivityRatio``: need of insulin by a temporary target, as a multiple of the usual one; None without one."""


@pytree
class Forecast:
    """Numbers that dosing takes from the four lines."""

    eventual_bg: jax.Array
    min_pred_bg: jax.Array
    min_iob_pred_bg: jax.Array
    min_guard_bg: jax.Array
    minutes_above_threshold: jax.Array
    """Time until glucose falls below the threshold; 240 if it does not."""


def effects_now(glucose: GlucoseStatus, iob: InsulinOnBoard, profile: DosingProfile) -> Effects:
    """Effects at the last reading, with the sensitivity that a temporary target and a ratio of autosens of 1 leave."""
    own_sens, ratio = jnp.asarray(profile.sens_mg_dl_U), _sensitivity_ratio(profile)
    sens, bg = rounded(own_sens if ratio is None else own_sens / ratio, 1), glucose.glucose_mg_dl
    bgi = rounded(-iob.activity_U_min * sens * 5.0, 2)
    min_delta = jnp.minimum(glucose.delta, glucose.short_avgdelta)
    min_avg_delta = jnp.minimum(glucose.short_avgdelta, glucose.long_avgdelta)
    deviation = whole(6.0 * (min_delta - bgi))
    for slower in (min_avg_delta, glucose.long_avgdelta):
        deviation = jnp.where(deviation < 0.0, whole(6.0 * (slower - bgi)), deviation)
    cautious = jnp.where(iob.iob_U > 0.0, sens, jnp.minimum(sens, own_sens))
    naive = whole(bg - iob.iob_U * cautious)
    return Effects(
        sens=sens,
        csf=sens / profile.carb_ratio_g_U,
        bgi=bgi,
        min_delta=min_delta,
        naive_eventual_bg=naive,
        eventual_bg=naive + deviation,
        sensitivity_ratio=ratio,
    )


def _sensitivity_ratio(profile: DosingProfile) -> jax.Array | None:
    """Ratio by a temporary target, where a preference has it change the need of insulin; None if none can be set."""
    if profile.temptarget_set is False:
        return None
    target = (jnp.asarray(profile.min_bg_mg_dl) + jnp.asarray(profile.max_bg_mg_dl)) / 2.0
    half = profile.half_basal_exercise_target_mg_dl - NORMAL_TARGET
    away = half + target - NORMAL_TARGET
    most = jnp.asarray(profile.autosens_max)
    ratio = jnp.where(half * away <= 0.0, most, half / jnp.where(away == 0.0, 1.0, away))
    raises = jnp.asarray(profile.high_temptarget_raises_sensitivity) | profile.exercise_mode
    lowers = jnp.asarray(profile.low_temptarget_lowers_sensitivity)
    changes = (raises & (target > NORMAL_TARGET)) | (lowers & (target < NORMAL_TARGET))
    return jnp.where(changes & profile.temptarget_set, rounded(jnp.minimum(ratio, most), 2), 1.0)


@pytree
class Lines:
    """Predicted glucose ``(ticks + 1,)`` of each line, the reading first."""

    iob: jax.Array
    cob: jax.Array
    uam: jax.Array
    zt: jax.Array
    fed: jax.Array
    """Whether carbohydrate on board appears in the line of COB."""
    rises: jax.Array
    """Whether glucose rises now beyond what insulin explains, or will by carbohydrate."""
    last_iob: jax.Array
    """Last point of the line of IOB."""


def forecast(
    glucose: GlucoseStatus,
    iob: InsulinOnBoard,
    meal: MealData,
    profile: DosingProfile,
    now: Effects,
    *,
    target_bg: jax.Array,
    threshold: jax.Array,
) -> Forecast:
    """Predict glucose, and reduce the four lines to the numbers by which insulin is dosed."""
    bg, uam = glucose.glucose_mg_dl, jnp.asarray(profile.enable_uam)
    lines = predicted(bg, iob, meal, profile, now)
    left = meal.meal_cob_g / jnp.where(meal.carbs_g > 0.0, meal.carbs_g, 1.0)  # fractionCarbsLeft
    guard_zt, guard_cob, guard_uam = _least(lines.zt), _least(lines.cob), _least(lines.uam)
    min_guard = jnp.where(
        lines.fed,
        jnp.where(uam, left * guard_cob + (1.0 - left) * guard_uam, guard_cob),
        jnp.where(uam, guard_uam, _least(lines.iob)),
    )
    min_iob = jnp.maximum(_LOWEST, _least(lines.iob, _INSULIN_PEAK))
    min_cob = jnp.maximum(_LOWEST, jnp.where(lines.fed, _least(lines.cob, _INSULIN_PEAK), _NONE))
    min_uam = jnp.maximum(_LOWEST, jnp.where(uam, _least(lines.uam, _UAM_WAIT), _NONE))
    min_zt_uam = _between_uam_and_zt(min_uam, guard_zt, target_bg, threshold)
    has_cob, has_uam = min_cob < _NONE, min_uam < _NONE
    least = jnp.maximum(min_iob, min_cob)
    blended = left * min_cob + (1.0 - left) * min_zt_uam  # blendedMinPredBG
    min_pred = jnp.where(
        meal.carbs_g > 0.0,
        jnp.where(
            has_cob,
            whole(jnp.where(uam, jnp.maximum(least, blended), least)),
            jnp.where(uam, min_zt_uam, whole(min_guard)),
        ),
        jnp.where(uam, jnp.maximum(min_iob, min_zt_uam), min_iob),
    )
    average = jnp.where(
        has_cob,
        jnp.where(has_uam, (1.0 - left) * lines.uam[-1] + left * lines.cob[-1], (lines.last_iob + lines.cob[-1]) / 2.0),
        jnp.where(has_uam, (lines.last_iob + lines.uam[-1]) / 2.0, lines.last_iob),
    )
    min_pred = jnp.minimum(min_pred, jnp.maximum(whole(average), guard_zt))
    max_cob = jnp.where(lines.fed, _last_above(lines.cob, lines.iob), bg)
    min_pred = jnp.where(max_cob > bg, jnp.minimum(min_pred, max_cob), min_pred)

    with_carbs = (meal.meal_cob_g > 0.0) & lines.rises
    eventual = now.eventual_bg
    for holds, line in ((with_carbs, lines.cob), (lines.rises & uam, lines.uam)):
        eventual = jnp.where(holds, jnp.maximum(eventual, _shown(line)[-1]), eventual)
    shown = jnp.where(with_carbs, _shown(lines.cob), _shown(lines.iob))
    minutes = 5.0 * numbered(len(shown), bg)
    return Forecast(
        eventual_bg=eventual,
        min_pred_bg=min_pred,
        min_iob_pred_bg=min_iob,
        min_guard_bg=whole(min_guard),
        minutes_above_threshold=jnp.min(jnp.where(shown < threshold, minutes, 240.0), axis=0),
    )


def shown_lines(
    glucose: GlucoseStatus, iob: InsulinOnBoard, meal: MealData, profile: DosingProfile
) -> dict[str, jax.Array]:
    """Lines ``(48, ...)`` as oref0 shows them, with the constant ends that it leaves out; NaN where it shows none.

    ``expected`` is that by whose end insulin is dosed.
    """
    now = effects_now(glucose, iob, profile)
    lines = predicted(glucose.glucose_mg_dl, iob, meal, profile, now)
    of_carbs = (meal.meal_cob_g > 0.0) & lines.rises
    of_rise = jnp.asarray(profile.enable_uam) & lines.rises
    by_iob, by_cob, by_uam, without = map(_shown, (lines.iob, lines.cob, lines.uam, lines.zt))
    return {
        "expected": jnp.where(of_carbs, by_cob, jnp.where(of_rise, by_uam, by_iob)),
        "iob": by_iob,
        "cob": jnp.where(of_carbs, by_cob, jnp.nan),
        "uam": jnp.where(of_rise, by_uam, jnp.nan),
        "zt": without,
    }


def predicted(bg: jax.Array, iob: InsulinOnBoard, meal: MealData, profile: DosingProfile, now: Effects) -> Lines:
    """``predBGs``: the four lines, before they are rounded and cut to the range of a sensor."""
    ticks = len(iob.ahead_U_min)
    n = numbered(ticks, bg, 1)
    uci = rounded(now.min_delta - now.bgi, 1)
    ci = jnp.minimum(uci, rounded(_MAX_ABSORPTION_G_H * now.csf * 5.0 / 60.0, 1))
    hours, peak, duration = _remaining_carbs(ci, meal, profile, now)
    bgi = rounded(-iob.ahead_U_min * now.sens * 5.0, 2)
    zt_bgi = rounded(-iob.zero_temp_ahead_U_min * now.sens * 5.0, 2)
    dev = ci * (1.0 - jnp.minimum(1.0, n / 12.0))
    falls = jnp.minimum(0.0, dev)
    pred_ci = jnp.maximum(0.0, jnp.maximum(0.0, ci) * (1.0 - n / jnp.maximum(duration * 2.0, 1.0)))
    intervals = jnp.minimum(n, hours * 12.0 - n)
    remaining_ci = jnp.maximum(0.0, intervals / (hours / 2.0 * 12.0) * peak)
    slope = jnp.minimum(rounded(meal.slope_from_max_deviation, 2), -rounded(meal.slope_from_min_deviation, 2) / 3.0)
    pred_uci = jnp.minimum(jnp.maximum(0.0, uci + n * slope), jnp.maximum(0.0, uci * (1.0 - n / 36.0)))
    iob_line = _line(bg, (bgi, dev))
    return Lines(
        iob=iob_line,
        cob=_line(bg, (bgi, falls, pred_ci, remaining_ci)),
        uam=_line(bg, (bgi, falls, pred_uci)),
        zt=_line(bg, (zt_bgi,)),
        fed=(duration != 0.0) | (peak > 0.0),
        rises=(ci > 0.0) | (peak > 0.0),
        last_iob=iob_line[-1] if ticks else now.eventual_bg,
    )


def _remaining_carbs(
    ci: jax.Array, meal: MealData, profile: DosingProfile, now: Effects
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Hours in which carbohydrate on board is absorbed, peak of what nothing tells of yet, and half of the duration.

    They are ``remainingCATime``, ``remainingCIpeak`` [mg/dl/5 min] and ``cid`` [5 min].
    """
    on_board, least, csf = meal.meal_cob_g, jnp.full_like(ci, _MIN_ABSORPTION_H), now.csf
    if now.sensitivity_ratio is not None:
        least = least / now.sensitivity_ratio
    age = whole(meal.last_carb_age_min)
    late = rounded(jnp.maximum(least, on_board / _ASSUMED_ABSORPTION_G_H) + 1.5 * age / 60.0, 1)
    hours = jnp.where(meal.carbs_g > 0.0, late, least)
    absorbed = jnp.maximum(0.0, ci / 5.0 * 60.0 * hours / 2.0) / csf
    ignored = meal.carbs_g * (1.0 - jnp.minimum(1.0, profile.remaining_carbs_fraction))
    remaining = jnp.maximum(0.0, on_board - absorbed - ignored)
    remaining = jnp.minimum(jnp.minimum(90.0, profile.remaining_carbs_cap_g), remaining)
    peak = remaining * csf * 5.0 / 60.0 / (hours / 2.0)
    moves = ci != 0.0
    lasts = jnp.maximum(0.0, on_board * csf / jnp.where(moves, ci, 1.0))
    return hours, peak, jnp.where(moves, jnp.minimum(hours * 60.0 / 5.0 / 2.0, lasts), 0.0)


def _line(bg: jax.Array, effects: tuple[jax.Array, ...]) -> jax.Array:
    """Predicted glucose ``(ticks + 1,)`` from the reading on; the effects of a tick are added one after another."""

    def tick(glucose: jax.Array, row: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
        for effect in row:
            glucose = glucose + effect
        return glucose, glucose

    return jnp.concatenate([bg[None], jax.lax.scan(tick, bg, effects)[1]])


def _least(line: jax.Array, first: int = 1) -> jax.Array:
    """Minimum glucose of a line from a point on, rounded; 999 without points."""
    return jnp.min(whole(line[first:]), axis=0, initial=_NONE)


def _shown(line: jax.Array) -> jax.Array:
    """A line as oref0 shows it: four hours, rounded, in the range of a sensor."""
    return whole(jnp.clip(line[:_KEPT], _LOWEST, _HIGHEST))


def _last_above(line: jax.Array, other: jax.Array) -> jax.Array:
    """Last point of a line that is above all of another line so far; its first point if none is (``maxCOBPredBG``)."""

    def tick(
        carry: tuple[jax.Array, jax.Array], row: tuple[jax.Array, jax.Array]
    ) -> tuple[tuple[jax.Array, jax.Array], None]:
        highest, last = carry
        highest = jnp.maximum(highest, row[1])
        return (highest, jnp.where(row[0] > highest, row[0], last)), None

    return jax.lax.scan(tick, (other[0], line[0]), (line[1:], other[1:]))[0][1]


def _between_uam_and_zt(
    min_uam: jax.Array, guard_zt: jax.Array, target_bg: jax.Array, threshold: jax.Array
) -> jax.Array:
    """``minZTUAMPredBG``: the minimum of the UAM line, drawn toward that of ZT."""
    part = (guard_zt - threshold) / (target_bg - threshold)
    half_way = (min_uam + guard_zt) / 2.0
    in_part = (min_uam + (min_uam * part + guard_zt * (1.0 - part))) / 2.0
    drawn = jnp.where(guard_zt < target_bg, in_part, jnp.where(guard_zt > min_uam, half_way, min_uam))
    return whole(jnp.where(guard_zt < threshold, half_way, drawn))
