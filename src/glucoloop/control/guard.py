"""Guard: a wrapper that keeps any controller within bounds, for any input."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.component.effects import PROFILE, READINGS, Need
from glucoloop.control.around import AroundAnother
from glucoloop.control.decision import eaten_in_min, is_known, target_mg_dl, with_rescue
from glucoloop.control.design_case import check_rate
from glucoloop.control.guard_doses import (
    MAX_BOLUS_MU,
    DoseHistory,
    OwnLimits,
    at_basal,
    initial_doses,
    largest_allowed_bolus,
    largest_allowed_rate,
    largest_possible_bolus,
    largest_possible_rate,
    repaired_doses,
    updated_doses,
)
from glucoloop.control.guard_forecast import Foresight, ForesightState
from glucoloop.control.guard_glucagon import (
    GlucagonHistory,
    allowed_glucagon,
    no_glucagon,
    repaired_glucagon,
    with_glucagon,
)
from glucoloop.control.guard_readings import (
    ReadingHistory,
    initial_readings,
    near,
    possible,
    repaired_readings,
    updated_readings,
)
from glucoloop.control.guard_settings import ForecastSettings, GuardSettings
from glucoloop.control.protocol import (
    Controller,
    Decision,
    DoseForecast,
    Observation,
    Status,
    forecast_of,
    uses_of,
)
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.therapy import Profile, given_profile
from glucoloop.units import MIN_PER_DAY

_ORDINARY_MG_DL: Final = 100.0
"""Setpoint that is assumed while no possible one was given."""
_MEMORY_BOUND: Final = 1e6
"""Bound on the numbers that a controller keeps, where it declares none of its own (`memory_bound`): the largest that
one of glucose and insulin has reason to keep are a bolus of 100 U, 1e5 mU, and the minutes of a year, 5.3e5.
"""
_MARGIN: Final = 1.4
"""Factor on a person's correction factor, since insulin in two depots is left longer than the guard counts it."""
_DAILY_DOSE_U_KG: Final = 0.5
"""Total daily dose by weight with which insulin therapy of type 1 diabetes begins; 0.4 to 1 U/kg are usual (American
Diabetes Association, Standards of Care in Diabetes, section 9).
"""
_MAX_CARBS_G: Final = 1000.0
"""Largest carbohydrate of a meal that is accepted."""


@pytree
class _GuardState:
    """State of a guard."""

    inner: Any
    """State of the inner controller."""
    readings: ReadingHistory
    doses: DoseHistory
    command_mU_min: jax.Array
    """Last dose that the guard asked for."""
    setpoint_mg_dl: jax.Array
    suspended: jax.Array
    """Indicator, 1 while insulin is suspended, else 0."""
    bolus_mU: jax.Array | None = None
    """Last bolus that the guard asked for; None where the inner controller gives none."""
    glucagon: GlucagonHistory | None = None
    """Glucagon that the guard asked for; None where the inner controller gives none."""
    foresight: ForesightState | None = None
    """State of the forecast; None for a guard without one."""


class _Accepted(NamedTuple):
    """Inputs of a sample as the guard takes them."""

    state: _GuardState
    """State of the guard, with impossible numbers replaced."""
    intact: jax.Array
    """Whether the record of doses was intact."""
    delivered_mU_min: jax.Array
    counted_mU_min: jax.Array
    """Rate that is counted, at least the reported one."""
    counted_bolus_mU: jax.Array | None
    setpoint_mg_dl: jax.Array
    readings: ReadingHistory
    accepted: jax.Array
    """Whether the reading is accepted."""
    jump: jax.Array
    at_ceiling: jax.Array
    """Whether it is the highest that the sensor shows, so that it may stay the same."""
    observation: Observation
    """Observation of the inner controller."""
    sound: jax.Array
    """Whether the memory of the inner controller was sound."""
    inner: Any
    """State of the inner controller, started again where it was not."""


@pytree
class Guard(AroundAnother):
    """A guarded controller; see `guarded`."""

    inner: Controller
    limits: DoseLimits
    basal_mU_min: jax.Array | float
    """Basal rate, or NaN for the rate at which the loop starts."""
    settings: GuardSettings = static()
    carb_share: jax.Array | float = 1.0
    """Insulin that a gram of carbohydrate needs by the profile, relative to the rule from the basal rate."""
    fall_share: jax.Array | float = 1.0
    """Fall of glucose by insulin that the guard assumes, relative to that of the settings."""
    foresight: Foresight | None = None
    """Forecast that every dose passes, or None."""
    by_schedule: bool = static(default=False)
    """Whether the basal rate changes from sample to sample."""

    @property
    def sample_time_min(self) -> float:
        """Sample time of the inner controller."""
        return self.inner.sample_time_min

    @property
    def uses(self) -> frozenset[Need]:
        """Needs that the inner controller meets, and the guard itself."""
        return uses_of(self.inner) | {READINGS, PROFILE}

    def with_basal(self, insulin_mU_min: jax.Array) -> Guard:
        """The same guard for a person with the given basal rate, which the inner controller gets too if it takes it."""
        with_basal = getattr(self.inner, "with_basal", None)
        inner = self.inner if with_basal is None else with_basal(insulin_mU_min)
        return dataclasses.replace(self, inner=inner, basal_mU_min=insulin_mU_min)

    def with_profile(self, profile: Profile) -> Guard:
        """The same guard for a person with the given profile, which the inner controller gets too if it takes it."""
        inner, basal = given_profile(self.inner, profile), jnp.asarray(profile.basal_mU_min)
        by_schedule = profile.past_basal_mU_min is not None
        guard = self.limited_by(profile)
        return dataclasses.replace(guard, inner=inner, basal_mU_min=basal, by_schedule=by_schedule)

    def limited_by(self, profile: Profile) -> Guard:
        """The same guard, whose limits of insulin follow a person's own ratio and factor where these are known."""
        rule, span = Profile(basal_mU_min=profile.basal_mU_min, setpoint_mg_dl=jnp.nan), self.settings.profile_span
        most: jax.Array | float = span
        if profile.weight_kg is not None and span > 1.0:
            # Who needs next to no basal insulin may need as much at meals as others of that weight.
            by_weight = _DAILY_DOSE_U_KG * jnp.asarray(profile.weight_kg) / rule.daily_dose_U()
            most = span * jnp.where(by_weight > 1.0, by_weight, 1.0)

        def share(known: Any, of_rule: Callable[[Any], jax.Array], least: Any, most: Any) -> jax.Array | float:
            return 1.0 if known is None else jnp.where(jnp.isnan(known), 1.0, jnp.clip(of_rule(known), least, most))

        return dataclasses.replace(
            self,
            carb_share=share(profile.carb_ratio_g_U, lambda ratio: rule.carb_ratio() / ratio, 1.0 / span, most),
            fall_share=share(
                profile.correction_mg_dl_U,
                lambda factor: _MARGIN * factor / rule.correction_factor(),
                1.0 / most,
                span,
            ),
            foresight=None if self.foresight is None else self.foresight.with_profile(profile),
        )

    def init(self, observation: Observation) -> _GuardState:
        """Steady state under the basal rate; the inner controller starts from the accepted part of the observation."""
        reported = observation.delivered_mU_min
        lowest, highest = self.limits.min_mU_min, self.limits.max_mU_min
        start = jnp.where(self._is_rate(reported), reported, lowest)
        basal = jnp.broadcast_to(jnp.asarray(self.basal_mU_min, reported.dtype), reported.shape)
        basal = jnp.clip(jnp.where(jnp.isfinite(basal), basal, start), lowest, highest)
        delivered = jnp.where(self._is_rate(reported), reported, basal)
        setpoint = self._setpoint(observation, jnp.full_like(observation.setpoint_mg_dl, _ORDINARY_MG_DL))
        setpoint = jnp.broadcast_to(setpoint, observation.glucose_mg_dl.shape)
        accepted = possible(observation.glucose_mg_dl, observation.valid, self.settings)
        accepted = accepted & near(observation.glucose_mg_dl, setpoint, self.settings, self.sample_time_min)
        readings = initial_readings(observation.glucose_mg_dl, accepted, setpoint)
        no_bolus = jnp.zeros_like(delivered) if self.gives_boluses else None
        clean = _clean(observation, readings, accepted, setpoint, delivered, no_bolus)
        return _GuardState(
            inner=self.inner.init(clean),
            readings=readings,
            doses=initial_doses(basal, delivered, self.sample_time_min, no_bolus).with_first_check(delivered, no_bolus),
            command_mU_min=delivered,
            setpoint_mg_dl=setpoint,
            suspended=jnp.zeros_like(delivered),
            bolus_mU=no_bolus,
            glucagon=no_glucagon(delivered) if self.gives_glucagon else None,
            foresight=None if self.foresight is None else self.foresight.init(clean, basal),
        )

    def step(self, state: _GuardState, observation: Observation) -> tuple[_GuardState, Decision]:
        """Accept or reject each input, let the inner controller decide, and bound its dose."""
        settings, own, every = self.settings, self._own_limits, self.sample_time_min
        inputs = self._accepted(state, observation)
        state, intact, delivered, setpoint = inputs.state, inputs.intact, inputs.delivered_mU_min, inputs.setpoint_mg_dl
        readings, accepted, clean = inputs.readings, inputs.accepted, inputs.observation
        inner, decision = self.inner.step(inputs.inner, clean)
        # A controller that put its own memory right says so by this status.
        sound = inputs.sound & jnp.isfinite(decision.insulin_mU_min) & (decision.status != int(Status.NON_FINITE))
        if decision.bolus_mU is not None:
            sound = sound & jnp.isfinite(decision.bolus_mU)

        # A reading that is not accepted may take insulin away, and never add any.
        is_possible = possible(observation.glucose_mg_dl, observation.valid, settings)
        lowest = jnp.where(
            is_possible, jnp.minimum(readings.glucose_mg_dl, observation.glucose_mg_dl), readings.glucose_mg_dl
        )
        above = lowest - setpoint
        excess = readings.glucose_mg_dl - setpoint
        doses = updated_doses(
            state.doses, inputs.counted_mU_min, inputs.counted_bolus_mU, excess, inputs.jump, own, settings, every
        )
        if self.by_schedule:
            basal = jnp.broadcast_to(jnp.asarray(self.basal_mU_min, delivered.dtype), delivered.shape)
            doses = at_basal(doses, jnp.clip(basal, self.limits.min_mU_min, self.limits.max_mU_min))
        allowed = largest_allowed_rate(
            doses, above, readings.unchanged_min > 0.0, own, settings, self.limits.max_change_mU_min, every
        )
        trusted = accepted & ((readings.unchanged_min <= settings.unchanged_min) | inputs.at_ceiling)
        allowed = jnp.where(trusted, allowed, doses.basal_mU_min)
        wanted = jnp.where(sound, decision.insulin_mU_min, doses.basal_mU_min)
        gap, long_gap = (
            readings.since_accepted_min > settings.gap_min,
            readings.since_accepted_min > settings.long_gap_min,
        )
        predicted = readings.glucose_mg_dl + settings.ahead_min * readings.trend_mg_dl_min
        bound = settings.low_mg_dl + settings.hysteresis_mg_dl * state.suspended
        suspended = jnp.minimum(predicted, lowest) < bound
        dose = jnp.minimum(wanted, allowed)
        # No insulin at all for longer would end in ketoacidosis, so that a request of nothing is not followed for ever.
        dose = jnp.where(long_gap, settings.reduced_fraction * doses.basal_mU_min, dose)
        dose = jnp.where(suspended, self.limits.min_mU_min, dose)
        # A report of more than was asked for lifts no dose: the pump goes down as fast as it can by itself.
        lowest_start = jnp.where(intact, jnp.minimum(delivered, state.command_mU_min), delivered)
        within = self._keeps(dose, delivered, lowest_start)
        dose = jnp.where(within, dose, self._clip(dose, delivered, lowest_start))

        limited, bolus, due = wanted > allowed, None, None
        eats = clean.announced_carbs_g > 0.0
        foresight, ahead = self.foresight, state.foresight
        if foresight is not None and ahead is not None:
            counted_mU = inputs.counted_mU_min * every
            if inputs.counted_bolus_mU is not None:
                counted_mU = counted_mU + inputs.counted_bolus_mU
            ahead = foresight.updated(ahead, clean, doses.basal_mU_min, counted_mU)
        if decision.bolus_mU is not None:
            requested = jnp.where(sound, jnp.maximum(decision.bolus_mU, 0.0), 0.0)
            # A reading that is not accepted calls for no insulin, but a meal does, which also ends a predicted low.
            may = jnp.where(eats, lowest >= settings.low_mg_dl, trusted & ~suspended) & ~gap
            change = self.limits.max_change_mU_min
            beside = largest_possible_rate(doses, dose, dose, change)
            due = requested
            if foresight is not None and ahead is not None:
                due, requested = foresight.requested(ahead, eats, requested)
            largest = largest_allowed_bolus(doses, beside, own, settings, change, every)
            bolus = jnp.where(may, jnp.minimum(requested, largest), 0.0)
            limited = limited | (due > bolus)
        if foresight is not None and ahead is not None:
            basal = doses.basal_mU_min
            most_mU, passes = foresight.passed(ahead, basal, dose, bolus, due, target_mg_dl(clean))
            # Without a forecast there is the basal rate, and no bolus. Where glucose is high, or unknown for long, no
            # forecast takes the basal rate, or the part of it, away: without any insulin for hours glucose would rise.
            high = accepted & (readings.glucose_mg_dl > foresight.settings.basal_above_mg_dl)
            least = jnp.where(long_gap, settings.reduced_fraction, jnp.where(high, 1.0, 0.0)) * basal
            fits = jnp.isfinite(most_mU)
            rate = jnp.minimum(dose, jnp.where(fits, jnp.maximum(most_mU / every, least), basal))
            cut = jnp.where(passes, dose, jnp.minimum(dose, self._clip(rate, delivered, lowest_start)))
            limited, dose = limited | (cut < dose), cut
            if bolus is not None and due is not None:
                rest = jnp.where(fits, jnp.clip(most_mU - dose * every, 0.0, bolus), 0.0)
                bolus = jnp.where(passes, bolus, rest)
                extra = bolus + jnp.maximum(dose - basal, 0.0) * every
                ahead = foresight.owing(ahead, eats, due, extra, (jnp.minimum(wanted, basal) - dose) * every)
                limited = limited | (due > bolus)

        glucagon, history = decision.glucagon_ug, state.glucagon
        if glucagon is not None and history is not None:
            low = trusted & sound & (readings.glucose_mg_dl < setpoint)
            glucagon = allowed_glucagon(history, glucagon, low, settings)
            history = with_glucagon(history, glucagon, every)

        status = decision.status
        for holds, kind in (
            (~within, Status.SATURATED),
            (is_known(observation) & ~accepted, Status.READING_REJECTED),
            (limited, Status.DOSE_LIMITED),
            (gap, Status.FALLBACK_BASAL),
            (long_gap, Status.FALLBACK_REDUCED),
            (suspended, Status.SUSPENDED),
            (~sound, Status.RESTARTED),
        ):
            status = jnp.where(holds, int(kind), status)
        state = _GuardState(
            inner=inner,
            readings=readings,
            doses=doses.with_check(dose, bolus),
            command_mU_min=dose,
            setpoint_mg_dl=setpoint,
            suspended=jnp.where(suspended, 1.0, 0.0).astype(dose.dtype),
            bolus_mU=bolus,
            glucagon=history,
            foresight=ahead,
        )
        return state, Decision(insulin_mU_min=dose, status=status, bolus_mU=bolus, glucagon_ug=glucagon)

    def forecast(self, state: _GuardState, observation: Observation) -> DoseForecast | None:
        """Forecast of the inner controller by the accepted inputs; the guard may give less than it plans."""
        inputs = self._accepted(state, observation)
        return forecast_of(self.inner, inputs.inner, inputs.observation)

    def _accepted(self, state: _GuardState, observation: Observation) -> _Accepted:
        """Accept or reject each input of a sample."""
        settings, every = self.settings, self.sample_time_min
        intact = state.doses.agrees(state.command_mU_min, state.bolus_mU)
        state = self._repaired(state, intact)
        # A pump that reports nothing is taken to have done as it was asked: so its insulin is not forgotten.
        reported = observation.delivered_mU_min
        rate_reported = self._is_rate(reported)
        delivered = jnp.where(rate_reported, reported, state.command_mU_min)
        # A report of less than was asked for may be wrong, so that it lowers no count.
        counted = largest_possible_rate(state.doses, state.command_mU_min, delivered, self.limits.max_change_mU_min)
        setpoint = self._setpoint(observation, state.setpoint_mg_dl)
        pushed = jnp.abs(state.doses.on_board) > settings.stuck_on_board
        at_ceiling = self._at_ceiling(state, observation)
        pushed = pushed & ~at_ceiling
        readings, accepted, jump = updated_readings(
            state.readings, observation.glucose_mg_dl, observation.valid, setpoint, pushed, settings, every
        )
        bolus_since = self._bolus_since(state, observation)
        counted_bolus = state.bolus_mU
        if bolus_since is not None and counted_bolus is not None:
            counted_bolus = jnp.maximum(bolus_since, counted_bolus)
        clean = _clean(observation, readings, accepted, setpoint, delivered, bolus_since)
        # A memory that is lost is put right before it is used and not when it is stored: this makes native code faster.
        heals = getattr(self.inner, "heals", False)
        sound = jnp.asarray(True) if heals else _all_sound(state.inner, delivered.shape, self._memory_bound)
        before = state.inner if heals else _where_sound(sound, state.inner, self.inner.init(clean))
        return _Accepted(
            state=state,
            intact=intact,
            delivered_mU_min=delivered,
            counted_mU_min=counted,
            counted_bolus_mU=counted_bolus,
            setpoint_mg_dl=setpoint,
            readings=readings,
            accepted=accepted,
            jump=jump,
            at_ceiling=at_ceiling,
            observation=clean,
            sound=sound,
            inner=before,
        )

    def _repaired(self, state: _GuardState, intact: jax.Array) -> _GuardState:
        """The state with every impossible number replaced, and the record of doses if it is not intact."""
        setpoint_mg_dl, suspended = state.setpoint_mg_dl, state.suspended
        setpoint = jnp.where(self._is_setpoint(setpoint_mg_dl), setpoint_mg_dl, _ORDINARY_MG_DL)
        basal = jnp.asarray(self.basal_mU_min, setpoint_mg_dl.dtype)
        own, before = self._own_limits, self.limits.max_mU_min + self.limits.max_change_mU_min
        doses = repaired_doses(state.doses, intact, basal, own, self._highest_rate, before)
        bolus, largest = state.bolus_mU, largest_possible_bolus(doses.basal_mU_min, own, self.settings)
        return _GuardState(
            inner=state.inner,
            readings=repaired_readings(state.readings, setpoint, self.settings),
            doses=doses,
            command_mU_min=jnp.where(intact, state.command_mU_min, doses.basal_mU_min),
            setpoint_mg_dl=setpoint,
            suspended=jnp.where(suspended == 0.0, 0.0, 1.0).astype(suspended.dtype),
            bolus_mU=None if bolus is None else jnp.where(intact, bolus, largest),
            glucagon=None if state.glucagon is None else repaired_glucagon(state.glucagon, self.settings),
            foresight=state.foresight,
        )

    @property
    def _own_limits(self) -> OwnLimits:
        return OwnLimits.of(self.settings, self.carb_share, self.fall_share)

    @property
    def _memory_bound(self) -> float:
        """Bound on the memory of the inner controller: its own, or the general one."""
        return float(getattr(self.inner, "memory_bound", _MEMORY_BOUND))

    @property
    def _highest_rate(self) -> jax.Array | float:
        """Highest rate that a pump may report, some way above limits that may not be its own."""
        return 2.0 * self.limits.max_mU_min

    def _is_rate(self, insulin_mU_min: jax.Array) -> jax.Array:
        """Whether a reported rate is possible."""
        return (insulin_mU_min >= 0.0) & (insulin_mU_min <= self._highest_rate)

    def _bolus_since(self, state: _GuardState, observation: Observation) -> jax.Array | None:
        """Bolus of the last sample; a pump that reports nothing possible is taken to have done as it was asked."""
        reported = observation.delivered_bolus_mU
        if state.bolus_mU is None or reported is None:
            return state.bolus_mU
        return jnp.where((reported >= 0.0) & (reported <= MAX_BOLUS_MU), reported, state.bolus_mU)

    def _at_ceiling(self, state: _GuardState, observation: Observation) -> jax.Array:
        """Whether a reading is the highest that the sensor shows, and it did not jump there."""
        if self.foresight is None:
            return jnp.zeros_like(observation.glucose_mg_dl, bool)
        high = observation.glucose_mg_dl >= self.foresight.settings.ceiling_mg_dl
        return high & (state.doses.sensor_jump_mg_dl <= self.settings.error_mg_dl)

    def _is_setpoint(self, setpoint_mg_dl: jax.Array) -> jax.Array:
        lowest, highest = self.settings.lowest_reading_mg_dl, self.settings.highest_reading_mg_dl
        return (setpoint_mg_dl >= lowest) & (setpoint_mg_dl <= highest)

    def _setpoint(self, observation: Observation, otherwise: jax.Array) -> jax.Array:
        setpoint = observation.setpoint_mg_dl
        return jnp.where(self._is_setpoint(setpoint), setpoint, otherwise)

    def _keeps(self, dose: jax.Array, delivered: jax.Array, lowest_start: jax.Array) -> jax.Array:
        """Whether a dose keeps the limits, up to the rounding of an earlier clip to the rate limit."""
        limits = self.limits
        change = limits.max_change_mU_min + 4.0 * jnp.finfo(dose.dtype).eps * limits.max_mU_min
        slow = (dose - delivered <= change) & (lowest_start - dose <= change)
        return slow & (dose >= limits.min_mU_min) & (dose <= limits.max_mU_min)

    def _clip(self, dose: jax.Array, delivered: jax.Array, lowest_start: jax.Array) -> jax.Array:
        """The nearest dose that keeps the limits; it rises from what was reported, and falls from `lowest_start`."""
        limits = self.limits
        slow = jnp.clip(dose, lowest_start - limits.max_change_mU_min, delivered + limits.max_change_mU_min)
        return jnp.clip(slow, limits.min_mU_min, limits.max_mU_min)


def _clean(
    observation: Observation,
    readings: ReadingHistory,
    accepted: jax.Array,
    setpoint: jax.Array,
    delivered: jax.Array,
    bolus_mU: jax.Array | None,
) -> Observation:
    """An observation whose fields are all possible values."""
    carbs, time = observation.announced_carbs_g, observation.time_of_day_min
    ahead = observation.exercise_in_min
    return Observation(
        glucose_mg_dl=readings.glucose_mg_dl,
        valid=accepted,
        setpoint_mg_dl=setpoint,
        delivered_mU_min=delivered,
        announced_carbs_g=jnp.where((carbs >= 0.0) & (carbs <= _MAX_CARBS_G), carbs, 0.0),
        delivered_bolus_mU=bolus_mU,
        time_of_day_min=None if time is None else jnp.where((time >= 0.0) & (time < MIN_PER_DAY), time, 0.0),
        announced_in_min=None if observation.announced_in_min is None else eaten_in_min(observation),
        rescue_carbs_g=None if observation.rescue_carbs_g is None else with_rescue(0.0 * delivered, observation),
        exercise_in_min=None if ahead is None else jnp.where(ahead >= 0.0, ahead, jnp.inf),
        temporary_target=observation.temporary_target,
        key=observation.key,
    )


def _floats(tree: Any) -> list[jax.Array]:
    leaves = map(jnp.asarray, jax.tree.leaves(tree))
    return [leaf for leaf in leaves if leaf.size and jnp.issubdtype(leaf.dtype, jnp.inexact)]


def _of_people(leaf: jax.Array, people: tuple[int, ...]) -> bool:
    """Whether the last axes of an array are those of people."""
    return leaf.shape[leaf.ndim - len(people) :] == people


def _all_sound(tree: Any, people: tuple[int, ...], bound: float) -> jax.Array:
    """Whether, for each person, every number is finite and within a bound."""
    rows = [
        leaf.reshape(-1, *people)
        if _of_people(leaf, people)
        else jnp.broadcast_to(jnp.max(jnp.abs(leaf)), (1, *people))
        for leaf in _floats(tree)
    ]
    if not rows:
        return jnp.ones(people, bool)
    return jnp.max(jnp.abs(jnp.concatenate(rows)), axis=0) <= bound


def _where_sound(sound: jax.Array, tree: Any, otherwise: Any) -> Any:
    """A state, replaced by another for people for whom it is not sound."""

    def choose(leaf: jax.Array, fresh: jax.Array) -> jax.Array:
        return jnp.where(sound if _of_people(jnp.asarray(leaf), sound.shape) else jnp.all(sound), leaf, fresh)

    return jax.tree.map(choose, tree, otherwise)


@checked
def guarded(
    controller: Controller,
    settings: GuardSettings | None = None,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    basal_mU_min: float | None = None,
) -> Guard:
    """Wrap a controller in a guard.

    At each sample, in this order:

    1. Every field of the observation is checked. A reading that is not a number, out of range, too fast or stuck is
       passed on as not valid, and the controller relies on its model; an impossible value of another field is replaced
       by the last possible one. Of the reported and the requested insulin the larger counts.
    2. The controller decides. If its memory or its dose is not finite or absurd, it is restarted and the basal rate is
       given. A memory is absurd beyond the controller's `memory_bound`, by default 1e6.
    3. The dose is cut to the largest that is allowed, ``b max(A, 1 + (B' - k B) / (1 - k))``, and to that of the hour,
       but not below the basal rate. ``B' = min((y - r - e - d) / F, B_max)`` is the insulin that may be on board, and
       at most ``B`` of it while the reading stays the same.
    4. Without an accepted reading the dose is at most the basal rate and at most what the controller asks for. After a
       long time without one it is a part of the basal rate, whatever the controller asks for.
    5. The dose is 0 while ``y + t y'`` is below the bound.
    6. The dose is clipped to the pump's limits: it rises from the reported rate, and falls from the lower of that and
       the requested one. A dose that no rule changed passes bit for bit.
    7. A bolus is cut so that insulin on board, which has all of it at once, stays within ``B_max``, and insulin in any
       window of 60 min, the rate included, within the cap of the hour. Readings do not bound it otherwise. No bolus is
       given while insulin is suspended nor on a reading that is not accepted, unless a meal is announced; and none at
       all while a possible reading is low or no reading was accepted for long.
    8. Glucagon, of a controller that gives it, is cut so that no hour and no 24 hours hold more than their caps; none
       is given above the setpoint, nor on a reading that is not accepted.

    Where a person's own carbohydrate ratio or correction factor is known, ``with_profile`` scales ``B_max``, the cap of
    the hour and ``F`` by it, up to the setting ``profile_span``; and further towards more insulin where by weight, 0.5
    U/kg, a person needs more in a day than by the basal rate.

    ============  =========================================================  ====================
    variable      meaning                                                    setting
    ============  =========================================================  ====================
    ``b``         basal rate
    ``B``         insulin on board, in basal rates beyond the basal rate     ``max_on_board``
    ``k``         share of it that is left after a sample                    ``on_board_tau_min``
    ``y - r``     the last accepted reading less the setpoint
    ``e, F, A``   error, fall, and dose that is always allowed               ``error_mg_dl``, ...
    ``d``         part of the reading that is due to a jump                  ``doubt_tau_min``
    ``t, y'``     time ahead, and trend                                      ``ahead_min``
    ============  =========================================================  ====================

    The status is that of the most serious rule that applied, or else the controller's own.

    Parameters
    ----------
    settings : GuardSettings, optional
    limits : DoseLimits
        Limits of the pump.
    basal_mU_min : float, optional
        Rate that holds glucose at the setpoint; by default that at which the loop starts.

    Raises
    ------
    ValueError
        For a basal rate outside the limits.

    Examples
    --------
    >>> from glucoloop.control import design_open_loop
    >>> guard = guarded(design_open_loop(), GuardSettings(gap_min=15.0))
    >>> guard.sample_time_min
    5.0
    """
    if basal_mU_min is not None:
        check_rate("basal", basal_mU_min, limits)
    settings = GuardSettings() if settings is None else settings
    foresight = None
    if isinstance(settings, ForecastSettings):
        foresight = Foresight.of(settings, controller.sample_time_min)
    return Guard(
        inner=controller,
        limits=limits,
        basal_mU_min=math.nan if basal_mU_min is None else basal_mU_min,
        settings=settings,
        foresight=foresight,
    )


def guard_settings_of(controller: Controller) -> GuardSettings | None:
    """Limits of a guard; None for a controller without one."""
    return controller.settings if isinstance(controller, Guard) else None
