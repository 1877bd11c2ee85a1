"""A controller after LoopKit's: a forecast that adds four effects on glucose, and the dose that corrects it.

It follows what LoopAlgorithm (https://github.com/LoopKit/LoopAlgorithm, `LoopMath`, `GlucoseMath`, `CarbMath`,
`StandardRetrospectiveCorrection` and `DoseMath`, as of 2026) computes for a person with one basal rate, one sensitivity
and one carbohydrate ratio whose readings and doses lie on the samples of the loop. It differs in this: up to four meals
are followed at a time, their overlapping absorption is shared by the rates of the model, and after a missing reading
the forecast begins at the forecast of that reading. The rate of absorption of a meal (`PiecewiseLinearAbsorption`)
rises for 15 % of the absorption time, stays to 50 %, and falls to 0 at the end. It is no product of LoopKit, and not
for treating people.

Insulin and carbohydrate on board, the parts of doses that have not acted and of meals that are not absorbed, are
defined by its curves: rapid-acting insulin of adults acts from 10 to 370 min after a dose, with a peak at 85 min
(`therapy.INSULINS`), and a meal is absorbed from 10 to 190 min after eating (`part_absorbed`). Insulin counts above the
basal rate, so that suspended insulin is below 0.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, Any, Final, Literal, Self

from glucoloop._disk_cache import keeps_result
from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop.component.pytree_component import derived
from glucoloop.component.setting import About
from glucoloop.control.decision import (
    announced_carbs,
    bolus_since,
    decide,
    delivered_since,
    eaten_in_min,
    is_known,
    rate_at_start,
    target_mg_dl,
    with_rescue,
)
from glucoloop.control.part import CarbRatio, CorrectionFactor, MealShare, OfPerson
from glucoloop.control.protocol import Decision, DoseForecast, Observation
from glucoloop.pumps.limits import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS, BolusLimits, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.therapy import INSULINS, Profile, insulin_left
from glucoloop.unit_guess import ACTION_TIME, GLUCOSE_BOUND
from glucoloop.units import MU_PER_U

MEALS: Final = 4
"""Meals that are followed at a time."""
_OVERRUN: Final = 1.5
"""Longest absorption of a meal, in absorption times; the forecast begins with it."""
_CARB_DELAY_MIN: Final = 10.0
"""Time from eating to the beginning of absorption."""
_MOMENTUM_MIN: Final = 15.0
"""Time over which the slope of readings is taken, and over which it fades into the other effects."""
_MAX_RISE_MG_DL_MIN: Final = 4.0
"""Largest slope upwards."""
_GROUPING_MIN: Final = 30.0
"""Time over which unexplained changes of glucose are added up."""
_CORRECTION_MIN: Final = 60.0
"""Time for which they are taken to go on, falling to 0."""
_RECENT_MIN: Final = 15.0
"""Age of a reading from which on no dose rests on it."""
_TEMPORARY_BASAL_MIN: Final = 30.0
"""Time over which a temporary basal rate is to correct the forecast."""
_BOLUS_SHARE: Final = 0.4
"""Share of the correction that is given as an automatic bolus."""
_READINGS: Final = 3
"""Minimum number of readings of a slope."""
_MAX_MG_DL: Final = 1000.0
"""Largest glucose; no sensor reads more."""
_SLACK: Final = 1.01
"""LoopKit's factor on the grouping time, by which both ends of it count."""


@pytree
class Meals:
    """Announced meals ``(meals, ...)``, the newest first; a meal of 0 g is none."""

    carbs_g: jax.Array
    since_min: jax.Array
    """Time since eating began; below 0 where it is still to come."""
    observed_g: jax.Array
    """Carbohydrate whose absorption was seen in the readings."""

    def with_new(self, carbs_g: jax.Array, in_min: jax.Array) -> Meals:
        """The meals after one more was announced, where it is more than 0 g; the oldest is forgotten."""

        def first(new: jax.Array, old: jax.Array) -> jax.Array:
            return jnp.where(carbs_g > 0.0, jnp.concatenate([new[None], old[:-1]]), old)

        zero = jnp.zeros_like(carbs_g)
        return Meals(
            carbs_g=first(carbs_g, self.carbs_g),
            since_min=first(0.0 - in_min, self.since_min),
            observed_g=first(zero, self.observed_g),
        )

    def seen(self, rise_g: jax.Array, longest_min: jax.Array | float, passed_min: float) -> Meals:
        """The meals after some time, in which glucose rose as by the absorption of some carbohydrate."""
        active = (self.carbs_g > 0.0) & (self.since_min < longest_min + _CARB_DELAY_MIN)
        rate = jnp.where(active, self.carbs_g * rate_of_absorption(self.since_min / longest_min), 0.0)
        left_g, rates, shares = jnp.maximum(rise_g, 0.0), jnp.sum(rate, axis=0), []
        for i in reversed(range(MEALS)):  # the oldest first
            share = left_g * rate[i] / jnp.where(rates > 0.0, rates, 1.0)
            share = jnp.minimum(share, jnp.maximum(self.carbs_g[i] - self.observed_g[i], 0.0))
            left_g, rates = left_g - share, rates - rate[i]
            shares.append(share)
        return Meals(
            carbs_g=self.carbs_g,
            since_min=jnp.minimum(self.since_min + passed_min, longest_min + 2.0 * _CARB_DELAY_MIN),
            observed_g=self.observed_g + jnp.stack(shares[::-1]),
        )

    def progress(self, longest_min: jax.Array | float) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Place of each meal on its course, the length of the course [min], and whether its absorption is seen.

        A meal goes on from where it was seen, as fast as the model does. One that is seen less than the slowest
        absorption has at least that.
        """
        time = self.since_min - _CARB_DELAY_MIN
        least = part_absorbed(time / longest_min)
        part = self.observed_g / jnp.where(self.carbs_g > 0.0, self.carbs_g, 1.0)
        seen = (self.since_min > 0.0) & (part >= least)
        begun = jnp.maximum(self.since_min, 0.0)
        length = jnp.where(time > 0.0, longest_min + _CARB_DELAY_MIN, longest_min + begun)
        at_seen = jnp.where(time > 0.0, time_of_part(jnp.clip(part, least, 1.0)), 0.0)
        return jnp.where(seen, at_seen, time / length), jnp.where(seen, longest_min, length), seen


@pytree
class _LoopLikeState:
    """State of the controller: readings, insulin that is still to act, and meals."""

    readings_mg_dl: jax.Array
    """(readings, ...) readings from which the slope is taken, the newest first; forecast where they are missing."""
    in_a_row: jax.Array
    """Number of valid readings in a row, up to that of a slope."""
    stale_min: jax.Array
    """Age of the newest valid reading."""
    acting_U: jax.Array
    """(samples, ...) insulin that acts in each coming sample, beside that of the basal rate."""
    unexplained_mg_dl: jax.Array
    """(samples, ...) changes of glucose that neither insulin nor meals explain, the newest first."""
    meals: Meals
    rate_mU_min: jax.Array
    """Rate in force."""
    requested_mU: jax.Array
    """Bolus that was asked for at the last sample, used if the pump reports nothing."""


class LoopLike(OfPerson, name="loop-like"):
    """Forecast and doses after LoopKit's: insulin, meals, unexplained changes, and the slope of readings.

    The forecast of glucose is the reading and the sum of the effects of insulin that is still to act, of meals that are
    still absorbed, of the changes of the last 30 min that these do not explain, which fade within an hour, and of the
    slope of the last 15 min, which fades into the other effects in as long. The dose is the minimum by which no
    forecast is above its target, where eventual glucose is above the range; the target goes from the suspend threshold
    to the setpoint in the second half of the action of insulin. Forecast glucose below the threshold suspends insulin.

    ====================  ====================================================================  ====================
    dose                  value                                                                 ``dosing``
    ====================  ====================================================================  ====================
    temporary basal rate  basal + dose in 30 min, up to ``max_basal`` basal rates               ``temporary-basal``
    automatic bolus       40 % of the dose; the rate is at most the basal rate                  ``automatic-bolus``
    bolus of a meal       the dose at its announcement, up to ``max_bolus_U``                   both
    ====================  ====================================================================  ====================

    Insulin on board is kept within twice the largest bolus. After 15 min without a reading the basal rate is given, and
    the bolus of a meal is that of the carbohydrate ratio.

    Examples
    --------
    >>> controller = LoopLike().of_person(Profile(basal_mU_min=15.0, setpoint_mg_dl=110.0, total_daily_dose_U=45.0))
    >>> round(float(controller.fall_per_U)), controller.horizon
    (40, 74)
    """

    sources = ("loopalgorithm",)

    dosing: Annotated[
        Literal["automatic-bolus", "temporary-basal"],
        About("Way of correcting: 40 % of the dose as a bolus at each sample, or a rate that gives it in 30 min."),
    ] = "automatic-bolus"
    insulin: Annotated[
        Literal["rapid-adult", "rapid-child", "fiasp", "lyumjev"], About("Insulin whose course of action is assumed.")
    ] = "rapid-adult"
    carb_ratio_g_U: CarbRatio = 0.0
    correction_mg_dl_U: CorrectionFactor = 0.0
    range_mg_dl: Annotated[
        float, About("Width of the correction range around the setpoint, in mg/dl.", at_least=0.0, at_most=200.0)
    ] = 10.0
    suspend_mg_dl: Annotated[
        float,
        About("Forecast glucose below which no insulin is given, in mg/dl.", above=0.0, quantity=GLUCOSE_BOUND),
    ] = 75.0
    absorption_min: Annotated[
        float, About("Absorption time of meals, in minutes.", above=0.0, quantity=ACTION_TIME)
    ] = 180.0
    max_basal: Annotated[float, About("Largest temporary rate, in basal rates.", at_least=1.0, at_most=20.0)] = 4.0
    max_bolus_U: Annotated[float, About("Largest bolus, in U; twice it is the most on board.", above=0.0)] = 10.0
    meal_bolus: MealShare = 1.0

    @derived
    def carbs_per_U(self) -> Any:
        """Carbohydrate that 1 U covers [g/U], as it was given or by the profile."""
        return self.carb_ratio_g_U or self._person.carb_ratio()

    @derived
    def fall_per_U(self) -> Any:
        """Fall of glucose by 1 U [mg/dl/U], as it was given or by the profile."""
        return self.correction_mg_dl_U or self._person.correction_factor()

    @derived
    def half_range_mg_dl(self) -> float:
        """Half the width of the correction range."""
        return self.range_mg_dl / 2.0

    def of_person(
        self,
        profile: Profile,
        limits: DoseLimits = PARKER_1999_LIMITS,
        *,
        bolus: BolusLimits = DEFAULT_BOLUS_LIMITS,
        sample_time_min: float = 5.0,
        allow_unusual: bool = False,
    ) -> Self:
        """The controller for a person and a pump; a sample time after which a reading no longer counts is refused."""
        if sample_time_min > _RECENT_MIN:
            raise Refusal(
                f"a sample time of {sample_time_min:g} min is not possible here, where a reading counts for "
                f"{_RECENT_MIN:g} min; give at most that"
            )
        return super().of_person(
            profile, limits, bolus=bolus, sample_time_min=sample_time_min, allow_unusual=allow_unusual
        )

    def settled(self) -> dict[str, Any]:
        """Basal rate, carbohydrate ratio and correction factor."""
        return {
            "basal_mU_min": self.basal_mU_min,
            "carb_ratio_g_U": self.carbs_per_U,
            "correction_mg_dl_U": self.fall_per_U,
        }

    # ------------------------------------------------------------------------------------------ curves

    @property
    def horizon(self) -> int:
        """Samples of the forecast, at whose end all insulin has acted."""
        kind = INSULINS[self.insulin]
        return math.ceil((kind.action_min + kind.delay_min) / self.sample_time_min - 1e-9)

    def left(self, samples: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        """Part of a dose that has not acted yet, some samples after it."""
        kind = INSULINS[self.insulin]
        with jax.ensure_compile_time_eval():
            return np.asarray(
                insulin_left(samples * self.sample_time_min - kind.delay_min, kind.action_min, kind.peak_min), float
            )

    @property
    def _slope_readings(self) -> int:
        return max(_READINGS, math.floor(_MOMENTUM_MIN / self.sample_time_min + 1e-9) + 1)

    @property
    def _longest_min(self) -> jax.Array | float:
        return _OVERRUN * self.absorption_min

    # ------------------------------------------------------------------------------------------ steps

    def init(self, observation: Observation) -> _LoopLikeState:
        """State of somebody who has rested at the basal rate, without a meal."""
        glucose = jnp.where(is_known(observation), observation.glucose_mg_dl, observation.setpoint_mg_dl)
        glucose = jnp.clip(glucose, 0.0, _MAX_MG_DL)
        zero = jnp.zeros_like(observation.delivered_mU_min)
        none = jnp.stack([zero] * MEALS)
        return _LoopLikeState(
            readings_mg_dl=jnp.stack([glucose] * self._slope_readings),
            in_a_row=zero,
            stale_min=zero,
            acting_U=jnp.stack([zero] * (self.horizon - 1)),
            unexplained_mg_dl=jnp.stack([zero] * self._grouped),
            meals=Meals(carbs_g=none, since_min=none, observed_g=none),
            rate_mU_min=rate_at_start(observation, jnp.asarray(self.basal_mU_min)),
            requested_mU=zero,
        )

    @property
    def _grouped(self) -> int:
        """Samples whose unexplained changes are added up; LoopKit counts those at both ends of the time."""
        return math.floor(_GROUPING_MIN * _SLACK / self.sample_time_min) + 1

    def step(self, state: _LoopLikeState, observation: Observation) -> tuple[_LoopLikeState, Decision]:
        """Include what was read and delivered, and correct the forecast."""
        state = self.observed(state, observation)
        carbs_g, basal = announced_carbs(observation), jnp.asarray(self.basal_mU_min)
        units, highest, spare = self._correction(self.glucose_ahead(state), target_mg_dl(observation))
        recent = state.stale_min < _RECENT_MIN
        limit_U = 2.0 * self.max_bolus_U - jnp.sum(state.acting_U, axis=0)
        for_forecast = jnp.where(recent, jnp.clip(units, 0.0, self.max_bolus_U), carbs_g / self.carbs_per_U)
        for_meal = jnp.where(carbs_g > 0.0, self.meal_bolus * for_forecast, 0.0)
        per_U = MU_PER_U / _TEMPORARY_BASAL_MIN
        most = basal
        automatic = jnp.zeros_like(for_meal)
        if self.dosing == "automatic-bolus":
            most_U = jnp.clip(limit_U, 0.0, _BOLUS_SHARE * self.max_bolus_U)
            automatic = jnp.where(highest & recent, jnp.clip(_BOLUS_SHARE * units, 0.0, most_U), 0.0)
        else:
            most = jnp.where(highest, jnp.minimum(self.max_basal * basal, basal + per_U * limit_U), basal)
            most = jnp.where(for_meal > 0.0, jnp.minimum(most, basal), most)  # the bolus corrects the forecast
        rate = jnp.where(spare, jnp.clip(basal + per_U * units, 0.0, jnp.maximum(most, 0.0)), 0.0)
        rate = jnp.where(recent, rate, basal)
        bolus = jnp.where(carbs_g > 0.0, for_meal, automatic) * MU_PER_U
        bolus = jnp.clip(jnp.where(jnp.isfinite(bolus), bolus, 0.0), 0.0, self.bolus.max_mU)
        decision = decide(rate, state.rate_mU_min, self.limits, is_known(observation))
        return dataclasses.replace(state, requested_mU=bolus), dataclasses.replace(decision, bolus_mU=bolus)

    def forecast(self, state: _LoopLikeState, observation: Observation) -> DoseForecast:
        """Forecast until all insulin has acted, under the basal rate, which the dose is to correct."""
        glucose = self.glucose_ahead(self.observed(state, observation))
        return DoseForecast(
            ahead_min=self.sample_time_min * jnp.arange(self.horizon + 1.0),
            glucose_mg_dl=glucose,
            insulin_mU_min=jnp.broadcast_to(jnp.asarray(self.basal_mU_min, glucose.dtype), glucose.shape),
        )

    def observed(self, state: _LoopLikeState, observation: Observation) -> _LoopLikeState:
        """State with a reading, what was delivered since the last sample, and an announced meal."""
        T, sensitivity = self.sample_time_min, jnp.asarray(self.fall_per_U)
        delivered = delivered_since(observation, state.rate_mU_min)
        given = jnp.clip(delivered, 0.0, self.limits.max_mU_min)
        bolus = bolus_since(observation, state.requested_mU, self.bolus)
        dose_U = ((given - self.basal_since_mU_min) * T + bolus) / MU_PER_U
        left = self.left(np.arange(self.horizon + 1))
        acted_U = state.acting_U[0] + dose_U * (1.0 - left[1])
        coming = jnp.concatenate([state.acting_U[1:], jnp.zeros_like(state.acting_U[:1])])
        acting = coming + _column(left[1:-1] - left[2:], dose_U) * dose_U
        # what insulin does not explain is absorption of meals, as far as there are any
        known = is_known(observation)
        y = jnp.clip(observation.glucose_mg_dl, 0.0, _MAX_MG_DL)
        fall = sensitivity * acted_U
        counteracted = y - state.readings_mg_dl[0] + fall
        per_g = sensitivity / self.carbs_per_U
        before = state.meals.progress(self._longest_min)
        meals = state.meals.seen(jnp.where(known, counteracted / per_g, 0.0), self._longest_min, T)
        at, length, seen = meals.progress(self._longest_min)
        modelled = meals.carbs_g * (part_absorbed(at) - part_absorbed(at - T / length))
        credited = meals.observed_g - state.meals.observed_g
        risen = per_g * jnp.sum(jnp.where(seen, credited, modelled), axis=0)
        expected = per_g * jnp.sum(
            meals.carbs_g * (part_absorbed(before[0] + T / before[1]) - part_absorbed(before[0])), axis=0
        )
        forecast = jnp.clip(state.readings_mg_dl[0] - fall + expected, 0.0, _MAX_MG_DL)
        unexplained = jnp.where(known, counteracted - risen, 0.0)
        glucose = jnp.where(known, y, forecast)
        row = jnp.minimum(state.in_a_row + 1.0, float(self._slope_readings))
        if observation.rescue_carbs_g is not None:
            rescue_g = with_rescue(jnp.zeros_like(glucose), observation)
            meals = meals.with_new(rescue_g, jnp.zeros_like(glucose))
        return _LoopLikeState(
            readings_mg_dl=jnp.concatenate([glucose[None], state.readings_mg_dl[:-1]]),
            in_a_row=jnp.where(known, row, 0.0),
            stale_min=jnp.where(known, 0.0, jnp.minimum(state.stale_min + T, 2.0 * _RECENT_MIN)),
            acting_U=acting,
            unexplained_mg_dl=jnp.concatenate([unexplained[None], state.unexplained_mg_dl[:-1]]),
            meals=meals.with_new(announced_carbs(observation), eaten_in_min(observation)),
            rate_mU_min=delivered,
            requested_mU=state.requested_mU,
        )

    def glucose_ahead(self, state: _LoopLikeState) -> jax.Array:
        """Glucose ``(1 + horizon, ...)`` from now on, at each sample: that of now, and the sum of all effects."""
        T, n, glucose = self.sample_time_min, self.horizon, state.readings_mg_dl[0]
        insulin = -self.fall_per_U * state.acting_U
        insulin = jnp.concatenate([insulin, jnp.zeros_like(insulin[:1])])
        at, length, _ = state.meals.progress(self._longest_min)
        ahead = _column(T * np.arange(n + 1.0), at)
        absorbed = jnp.sum(state.meals.carbs_g * part_absorbed(at + ahead / length), axis=1)
        carbs = self.fall_per_U / self.carbs_per_U * jnp.diff(absorbed, axis=0)
        velocity = jnp.sum(state.unexplained_mg_dl, axis=0) / _GROUPING_MIN
        fades = T * np.clip(1.0 - T * np.arange(n) / (_CORRECTION_MIN - T), 0.0, 1.0)
        effects = insulin + carbs + _column(fades, velocity) * velocity
        points = math.floor(_MOMENTUM_MIN / T + 1e-9)
        if points >= _READINGS - 1:
            share = np.clip((points - np.arange(1.0, n + 1.0)) / (points - 1), 0.0, 1.0)
            split = _column(share, velocity) * (state.in_a_row >= _READINGS)
            effects = (1.0 - split) * effects + split * T * self._slope(state)
        return jnp.concatenate([glucose[None], glucose + jnp.cumsum(effects, axis=0)])

    def _slope(self, state: _LoopLikeState) -> jax.Array:
        """Slope of the valid readings in a row, by least squares [mg/dl/min]."""
        order = np.arange(float(self._slope_readings))
        weight = jnp.where(_column(order, state.in_a_row) < state.in_a_row, 1.0, 0.0)
        times = _column(-self.sample_time_min * order, state.in_a_row)
        t = weight * (times - jnp.sum(weight * times, axis=0) / jnp.maximum(jnp.sum(weight, axis=0), 1.0))
        slope = jnp.sum(t * state.readings_mg_dl, axis=0) / jnp.maximum(jnp.sum(t * t, axis=0), 1e-9)
        return jnp.minimum(slope, _MAX_RISE_MG_DL_MIN)

    def _correction(self, forecast: jax.Array, setpoint_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Insulin [U] that corrects a forecast, whether more than the basal rate may be given, and whether any."""
        n, kind = self.horizon, INSULINS[self.insulin]
        low, high = setpoint_mg_dl - self.half_range_mg_dl, setpoint_mg_dl + self.half_range_mg_dl
        passed = self.sample_time_min * np.arange(n + 1.0) / (kind.action_min + kind.delay_min)
        late = _column(np.clip(2.0 * passed - 1.0, 0.0, 1.0), setpoint_mg_dl)
        target = self.suspend_mg_dl + (setpoint_mg_dl - self.suspend_mg_dl) * late
        acted = _column(np.maximum(1.0 - self.left(np.arange(n + 1)), 1e-12), setpoint_mg_dl)
        effect = acted * self.fall_per_U
        needed = (forecast - target) / effect
        least, eventual = jnp.min(forecast, axis=0), forecast[-1]
        first = jnp.min(jnp.where(forecast <= least, effect, jnp.inf), axis=0)
        below = (least < low) & (eventual < low)
        units = jnp.where(eventual > high, jnp.min(jnp.where(needed > 0.0, needed, jnp.inf), axis=0), 0.0)
        units = jnp.where(below, (least - setpoint_mg_dl) / first, units)
        spare = least >= self.suspend_mg_dl
        units = jnp.where(spare & jnp.isfinite(units), units, 0.0)
        return units, least >= low, spare


def _column(values: npt.NDArray[np.float64], like: jax.Array) -> jax.Array:
    """Numbers along a first axis, before those of an array."""
    return jnp.asarray(values).reshape(-1, *(1,) * jnp.ndim(like))


_RISES_TO: Final = 0.15
_FALLS_FROM: Final = 0.5
_RATE: Final = 2.0 / (1.0 + _FALLS_FROM - _RISES_TO)
"""Maximum rate, in meals per absorption time, by which all of the meal is absorbed."""


def rate_of_absorption(x: jax.Array) -> jax.Array:
    """Rate, in meals per absorption time, at a part x of the absorption time; 0 outside of it."""
    falls = (1.0 - x) / (1.0 - _FALLS_FROM)
    return _RATE * jnp.clip(jnp.minimum(x / _RISES_TO, falls), 0.0, 1.0)


def part_absorbed(x: Any, xp: Any = jnp) -> Any:
    """Part of a meal that is absorbed at a part x of the absorption time, the integral of the rate."""
    rising = xp.clip(x, 0.0, _RISES_TO)
    flat = xp.clip(x, _RISES_TO, _FALLS_FROM) - _RISES_TO
    falling = xp.clip(x, _FALLS_FROM, 1.0) - _FALLS_FROM
    return _RATE * (rising**2 / (2.0 * _RISES_TO) + flat + falling * (1.0 - falling / (2.0 * (1.0 - _FALLS_FROM))))


def time_of_part(part: jax.Array) -> jax.Array:
    """Part of the absorption time at which a part of a meal is absorbed, from 0 to 1: the inverse."""
    rising = jnp.sqrt(2.0 * _RISES_TO / _RATE * jnp.maximum(part, 0.0))
    flat = 0.5 * _RISES_TO + part / _RATE
    falling = 1.0 - jnp.sqrt(2.0 * (1.0 - _FALLS_FROM) / _RATE * jnp.maximum(1.0 - part, 0.0))
    return jnp.where(rising < _RISES_TO, rising, jnp.where(flat < _FALLS_FROM, flat, falling))


_INSULIN: Final = INSULINS["rapid-adult"]
_MEAL_MIN: Final = 180.0
_LONGEST_MIN: Final = _INSULIN.delay_min + _INSULIN.action_min
"""Time after which nothing is on board, longer for insulin than for a meal."""


@keeps_result
def on_board_curves(sample_time_min: float) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Parts of a dose and of a meal that are on board at whole samples after them, ``(samples,)``, the last ones 0."""
    t_min = sample_time_min * np.arange(np.ceil(_LONGEST_MIN / sample_time_min) + 1)
    insulin = insulin_left(t_min - _INSULIN.delay_min, _INSULIN.action_min, _INSULIN.peak_min, np)
    carbs = 1.0 - part_absorbed((t_min - _CARB_DELAY_MIN) / _MEAL_MIN, np)
    return insulin, carbs


def on_board(amounts: npt.ArrayLike, curve: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Amount on board at each sample ``(samples, ...)``, of what was given at the samples before, without its own."""
    given = np.asarray(amounts, np.float64)
    later = np.append(0.0, curve[1:])
    columns = given.reshape(len(given), -1).T
    each = [np.convolve(column, later)[: len(given)] for column in columns]
    result: npt.NDArray[np.float64] = np.stack(each, axis=-1).reshape(given.shape)
    return result
