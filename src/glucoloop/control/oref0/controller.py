"""The controller that holds the histories from which oref0 doses, for one person or many.

It acts every 5 min. The ratio of autosens is 1: the profile is what the person has, and nothing is learned from days
gone by. A person who announces a meal gives a bolus for it by the carbohydrate ratio, and oref0 knows of both.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, Self

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.effects import TEMPORARY_TARGETS, Need
from glucoloop.component.pytree_component import DATA, HOST, STATIC, derived
from glucoloop.component.setting import About
from glucoloop.control.decision import (
    MealsToCome,
    announced_carbs,
    bolus_since,
    decide,
    delivered_since,
    hear,
    is_known,
    no_meals_to_come,
    target_mg_dl,
    with_rescue,
)
from glucoloop.control.oref0.dose import determine_basal
from glucoloop.control.oref0.forecast import shown_lines
from glucoloop.control.oref0.inputs import (
    DEVIATIONS,
    MEALS,
    PEAKS_MIN,
    READINGS,
    SAMPLE_MIN,
    bucketed,
    exercise_share,
    glucose_get_last,
    iob_total,
    recent_carbs,
    treatments,
)
from glucoloop.control.oref0.records import (
    DosingProfile,
    GlucoseStatus,
    InsulinOnBoard,
    MealData,
    TempBasal,
    rounded,
    whole,
)
from glucoloop.control.part import FOR_MEALS, CarbRatio, CorrectionFactor, OfPerson
from glucoloop.control.protocol import Decision, DoseForecast, Observation
from glucoloop.pumps.limits import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS, BolusLimits, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.therapy import Profile
from glucoloop.unit_guess import ACTION_TIME, BOLUS_STEP, GLUCOSE_BOUND
from glucoloop.units import MIN_PER_H, MU_MIN_PER_U_H, MU_PER_U, u_h_from_mu_min

_LOWEST_MG_DL, _HIGHEST_MG_DL = 39.0, 600.0
"""Range of a reading that is used. Sensors show 40 to 400; 39 stands for what is lower, since 38 is a code of an error.
"""
_TARGETS_MG_DL: Final = (80.0, 200.0)
"""Bounds of a target (``bound_target_range`` of ``profile/targets.js``)."""
_LONG_AGO_MIN: Final = 1e4
_MIN_BASAL_U_H: Final = 0.01
"""Minimum basal rate of a profile, so that a person without one has finite numbers."""
_MEALS_A_DAY, _MEAL_SHARE = 3.0, 0.5
"""Mean meal of the rule for insulin on board: a third of half the total daily dose."""
_BASAL_HOURS: Final = 3.0


def _pushed(row: jax.Array, newest: jax.Array) -> jax.Array:
    """A history with a new entry at its head."""
    return jnp.concatenate([newest[None], row[:-1]])


def _written(rate_mU_min: Any) -> jax.Array:
    """Rate in U/h as it was written, where it was: the two changes of its unit may move its last digit."""
    return rounded(u_h_from_mu_min(jnp.asarray(rate_mU_min)), 9)


def _is_temporary(observation: Observation) -> jax.Array | bool:
    """``temptargetSet``: whether the target is a temporary one, or that of announced exercise."""
    temporary: jax.Array | bool = False
    if observation.temporary_target is not None:
        temporary = observation.temporary_target
    if observation.exercise_in_min is not None:
        temporary = temporary | (observation.exercise_in_min < jnp.inf)
    return temporary


_AT_TIMES: Final = Need("enable_smb_always is on")
_HIGH: Final = Need("enable_smb_high_bg is off")
_SMB: Final = Need("no microboluses are enabled")
_SENSITIVITY: Final = Need("no temporary target changes the sensitivity")


@pytree
class _Oref0State:
    """Histories, the newest first, and the temporary basal rate in force."""

    readings_mg_dl: jax.Array
    """Readings of 50 min; 0 where there was none."""
    glucose_mg_dl: jax.Array
    """Glucose of six hours, with a line where there was no reading."""
    activity_U_min: jax.Array
    """Insulin activity of six hours."""
    insulin_U: jax.Array
    """Insulin of each past sample beyond the basal rate, boluses included."""
    carbs_g: jax.Array
    """Announced carbohydrate of six hours, when it is eaten."""
    gap: jax.Array
    """Samples since the last reading."""
    temp: TempBasal
    since_bolus_min: jax.Array
    """Time since the last bolus."""
    requested_mU_min: jax.Array
    """Rate that was requested at the last sample, used if the pump reports nothing."""
    requested_mU: jax.Array
    """Bolus that was requested at the last sample, likewise."""
    to_come: MealsToCome | None = None
    """Meals that are still to be eaten; None where observations tell no time of eating."""
    replaced_U: jax.Array | None = None
    """Basal insulin of each past sample with a temporary rate in force, 0 of others; None without exercise mode."""


class _Heard(NamedTuple):
    """State at a sample before the dose, and the arguments of the original."""

    state: _Oref0State
    glucose: GlucoseStatus
    iob: InsulinOnBoard
    meal: MealData
    profile: DosingProfile
    meal_mU: jax.Array
    """Bolus for an announced meal."""


class Oref0(OfPerson, name="oref0"):
    """oref0 0.7.1 of OpenAPS: temporary basal rates and microboluses by four forecasts; research only.

    The defaults are those of oref0, but for two that allow no more than a temporary basal rate below the person's own
    until they are changed: ``max_iob_U``, which is 0 there, and ``enable_smb_always``, which is off there. Preferences
    have their names of there. It is neither oref0 nor a medical device.

    Four forecasts start from the reading, by insulin on board, carbohydrate on board, glucose that nobody announced,
    and no basal insulin. By the minimum of them, insulin is suspended; by where they end, a temporary basal rate or a
    microbolus is given, of half the insulin that is wanting.

    ==================  ==========================================================  =====================
    variable            meaning                                                     size
    ==================  ==========================================================  =====================
    ``readings``        readings, for the change of glucose                         11
    ``glucose``         glucose of six hours, for deviations                        71
    ``activity``        insulin activity of six hours                               70
    ``insulin``         insulin beyond the basal rate                               60, or by its action
    ``carbs``           announced carbohydrate of six hours                         72
    ==================  ==========================================================  =====================

    Examples
    --------
    >>> controller = Oref0().of_person(Profile(basal_mU_min=15.0, setpoint_mg_dl=100.0))
    >>> round(float(controller.settled()["max_iob_U"]), 1)
    9.9
    """

    sources = ("lewis2016", "oref0")
    role_of_settings: ClassVar = HOST
    memory_bound: ClassVar[float] = 2e4
    """Bound on its memory for a guard: times end at 10 000 min, and no other number is as large."""

    meal_bolus: Annotated[
        float,
        About(
            "Share of an announced meal for which the person gives a bolus by the carbohydrate ratio; 0: no bolus.",
            at_least=0.0,
            at_most=1.0,
            needs=FOR_MEALS,
        ),
        DATA,
    ] = 1.0
    carb_ratio_g_U: CarbRatio = 0.0
    correction_mg_dl_U: CorrectionFactor = 0.0
    curve: Annotated[
        Literal["rapid-acting", "ultra-rapid"],
        About("Curve of insulin action, which peaks after 75 or 55 min."),
        STATIC,
    ] = "rapid-acting"
    insulin_action_min: Annotated[
        float, About("Time for which insulin acts (DIA).", at_least=300.0, at_most=600.0, quantity=ACTION_TIME), STATIC
    ] = 300.0
    insulin_peak_min: Annotated[
        float, About("Time of the peak of insulin action; 0: of the curve.", at_least=0.0, at_most=120.0), STATIC
    ] = 0.0
    max_iob_U: Annotated[
        float,
        About(
            "Largest insulin on board above the basal rate; 0: three hours of the basal rate and a mean meal's bolus.",
            at_least=0.0,
        ),
    ] = 0.0
    max_basal_mU_min: Annotated[
        float, About("Largest temporary basal rate; 0: as the two multipliers and the pump allow.", at_least=0.0)
    ] = 0.0
    max_daily_safety_multiplier: Annotated[
        float, About("Largest temporary basal rate, in basal rates of the day.", above=0.0)
    ] = 3.0
    current_basal_safety_multiplier: Annotated[
        float, About("Largest temporary basal rate, in present basal rates.", above=0.0)
    ] = 4.0
    enable_uam: Annotated[bool, About("Whether meals that nobody announced are forecast.")] = True
    enable_smb_always: Annotated[bool, About("Whether microboluses are given at any time.")] = True
    enable_smb_with_cob: Annotated[
        bool, About("Whether microboluses are given with carbohydrate on board.", needs=(_AT_TIMES, *FOR_MEALS))
    ] = False
    enable_smb_after_carbs: Annotated[
        bool, About("Whether microboluses are given for six hours after a meal.", needs=(_AT_TIMES, *FOR_MEALS))
    ] = False
    enable_smb_high_bg: Annotated[
        bool, About("Whether microboluses are given while glucose is high.", needs=(_AT_TIMES,))
    ] = False
    enable_smb_high_bg_target_mg_dl: Annotated[
        float,
        About(
            "Glucose from which enable_smb_high_bg takes it for high.",
            above=0.0,
            quantity=GLUCOSE_BOUND,
            needs=(_AT_TIMES, _HIGH),
        ),
    ] = 110.0
    allow_smb_with_high_temptarget: Annotated[
        bool,
        About(
            "Whether microboluses are given at a temporary target above 100 mg/dl too.",
            needs=(TEMPORARY_TARGETS, _SMB),
        ),
    ] = False
    enable_smb_with_temptarget: Annotated[
        bool,
        About(
            "Whether microboluses are given at a temporary target below 100 mg/dl.",
            needs=(TEMPORARY_TARGETS, _AT_TIMES),
        ),
    ] = False
    high_temptarget_raises_sensitivity: Annotated[
        bool,
        About(
            "Whether a temporary target above 100 mg/dl lowers basal rate and corrections.", needs=(TEMPORARY_TARGETS,)
        ),
    ] = False
    low_temptarget_lowers_sensitivity: Annotated[
        bool,
        About("Whether one below 100 mg/dl raises basal rate and corrections.", needs=(TEMPORARY_TARGETS,)),
    ] = False
    exercise_mode: Annotated[
        bool,
        About(
            "high_temptarget_raises_sensitivity, and temporary rates so far count against the lower basal rate.",
            needs=(TEMPORARY_TARGETS,),
        ),
        STATIC,
    ] = False
    half_basal_exercise_target_mg_dl: Annotated[
        float,
        About(
            "Temporary target at which the basal rate is halved.",
            at_least=110.0,
            at_most=300.0,
            quantity=GLUCOSE_BOUND,
            needs=(TEMPORARY_TARGETS, _SENSITIVITY),
        ),
    ] = 160.0
    autosens_max: Annotated[
        float,
        About(
            "Largest factor on basal rate and corrections by a temporary target.",
            at_least=1.0,
            at_most=2.0,
            needs=(TEMPORARY_TARGETS, _SENSITIVITY),
        ),
    ] = 1.2
    max_smb_basal_min: Annotated[
        float, About("Largest microbolus, in minutes of the basal rate.", above=0.0, needs=(_SMB,))
    ] = 30.0
    max_uam_smb_basal_min: Annotated[
        float,
        About(
            "Largest microbolus where insulin on board covers the carbohydrate, in minutes of the basal rate.",
            above=0.0,
            needs=(_SMB,),
        ),
    ] = 30.0
    smb_interval_min: Annotated[
        float, About("Minimum time from one bolus to a microbolus.", at_least=1.0, at_most=10.0, needs=(_SMB,))
    ] = 3.0
    bolus_increment_U: Annotated[
        float, About("Step of microboluses.", above=0.0, quantity=BOLUS_STEP, needs=(_SMB,))
    ] = 0.1
    max_delta_bg_threshold: Annotated[
        float,
        About(
            "Rise in 5 min, as a share of glucose, above which no microbolus is given.",
            above=0.0,
            at_most=0.3,
            needs=(_SMB,),
        ),
    ] = 0.2
    min_5m_carbimpact: Annotated[
        float, About("Minimum rise of glucose by carbohydrate on board, in mg/dl per 5 min.", above=0.0)
    ] = 8.0
    max_cob_g: Annotated[float, About("Largest carbohydrate on board.", above=0.0)] = 120.0
    remaining_carbs_fraction: Annotated[
        float, About("Share of carbohydrate that appears though nothing tells of it yet.", above=0.0, at_most=1.0)
    ] = 1.0
    remaining_carbs_cap_g: Annotated[
        float, About("Largest carbohydrate that appears though nothing tells of it yet.", above=0.0, at_most=90.0)
    ] = 90.0
    steps_per_U_h: Annotated[
        Literal[20, 40], About("Steps of 1 U/h of a temporary basal rate below 1 U/h; 40 of the pumps x23 and x54.")
    ] = 20
    flat_is_error: Annotated[
        bool, About("Whether readings that do not change for 40 min are taken for an error of the sensor.")
    ] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        least, most = (50.0, 120.0) if self.curve == "rapid-acting" else (35.0, 100.0)
        if self.insulin_peak_min and not least <= self.insulin_peak_min <= most:
            raise Refusal(
                f"a peak of {self.curve} insulin after {self.insulin_peak_min:g} min is not possible; "
                f"give insulin_peak_min from {least:g} to {most:g} min, or 0"
            )

    def uses(self) -> frozenset[Need]:
        """Needs that the controller meets; microboluses where a preference enables them."""
        at_times = frozenset(() if self.enable_smb_always else {_AT_TIMES})
        high = frozenset({_HIGH} if self.enable_smb_high_bg else ())
        enabled = self.enable_smb_always or self.enable_smb_with_cob or self.enable_smb_after_carbs
        enabled = enabled or self.enable_smb_high_bg or self.enable_smb_with_temptarget
        sensitivity = self.high_temptarget_raises_sensitivity or self.low_temptarget_lowers_sensitivity
        sensitivity = sensitivity or self.exercise_mode
        return (
            super().uses()
            | at_times
            | high
            | frozenset({_SMB} if enabled else ())
            | frozenset({_SENSITIVITY} if sensitivity else ())
        )

    def of_person(
        self,
        profile: Profile,
        limits: DoseLimits = PARKER_1999_LIMITS,
        *,
        bolus: BolusLimits = DEFAULT_BOLUS_LIMITS,
        sample_time_min: float = float(SAMPLE_MIN),
        allow_unusual: bool = False,
    ) -> Self:
        """The controller for a person and a pump; another sample time than 5 min is refused."""
        if sample_time_min != SAMPLE_MIN:
            raise Refusal(
                f"oref0 doses every {SAMPLE_MIN} min, and not every {sample_time_min:g} min; "
                "give the controller every=5min, or the loop a sample time of 5 min"
            )
        return super().of_person(
            profile, limits, bolus=bolus, sample_time_min=sample_time_min, allow_unusual=allow_unusual
        )

    @derived
    def setpoint_mg_dl(self) -> jax.Array:
        """The person's setpoint."""
        setpoint: jax.Array = jnp.asarray(self._person.setpoint_mg_dl, jnp.asarray(self._person.basal_mU_min).dtype)
        return setpoint

    @derived
    def dosing(self) -> DosingProfile:
        """Profile of oref0, from that of the person and the settings."""
        profile = self._person
        most = profile.max_daily_basal_mU_min
        basal: jax.Array = jnp.maximum(_written(profile.basal_mU_min), _MIN_BASAL_U_H)
        target = whole(jnp.asarray(profile.setpoint_mg_dl, basal.dtype))
        by_rule = _BASAL_HOURS * basal + profile.daily_dose_U() * _MEAL_SHARE / _MEALS_A_DAY
        maximum = self.limits.max_mU_min
        if self.max_basal_mU_min:
            maximum = jnp.minimum(maximum, self.max_basal_mU_min)
        preferences = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(DosingProfile)
            if field.default is not dataclasses.MISSING and field.name not in ("max_iob_U", "temptarget_set")
        }
        return DosingProfile(
            current_basal_U_h=basal,
            max_daily_basal_U_h=basal if most is None else jnp.maximum(basal, _written(most)),
            max_basal_U_h=u_h_from_mu_min(jnp.asarray(maximum)),
            sens_mg_dl_U=self.correction_mg_dl_U or profile.correction_factor(),
            carb_ratio_g_U=self.carb_ratio_g_U or profile.carb_ratio(),
            min_bg_mg_dl=target,
            max_bg_mg_dl=target,
            max_iob_U=self.max_iob_U or by_rule,
            **preferences,
        )

    def settled(self) -> dict[str, Any]:
        """Basal rate, carb ratio, correction factor and the largest insulin on board."""
        profile = self.dosing
        return {
            "basal_mU_min": self.basal_mU_min,
            "carb_ratio_g_U": profile.carb_ratio_g_U,
            "correction_mg_dl_U": profile.sens_mg_dl_U,
            "max_iob_U": profile.max_iob_U,
        }

    def init(self, observation: Observation) -> _Oref0State:
        """State after hours with this reading, the basal rate, no bolus and no meal."""
        zero = jnp.zeros_like(observation.delivered_mU_min)
        reading = self._reading(observation, jnp.broadcast_to(self._setpoint(observation), zero.shape))

        def row(count: int) -> jax.Array:
            return jnp.zeros((count, *zero.shape), zero.dtype)

        return _Oref0State(
            readings_mg_dl=row(READINGS),
            glucose_mg_dl=row(DEVIATIONS + 1) + reading,
            activity_U_min=row(DEVIATIONS),
            insulin_U=row(treatments(self._action_h) - 1),
            carbs_g=row(MEALS),
            gap=zero + 1.0,
            temp=TempBasal(rate_U_h=zero, duration_min=zero),
            since_bolus_min=zero + _LONG_AGO_MIN,
            requested_mU_min=zero + self.basal_mU_min,
            requested_mU=zero,
            to_come=no_meals_to_come(observation),
            replaced_U=row(treatments(self._action_h) - 1) if self.exercise_mode else None,
        )

    def step(self, state: _Oref0State, observation: Observation) -> tuple[_Oref0State, Decision]:
        """Take in what was read, given and announced, and dose."""
        heard = self._heard(state, observation)
        after, temp = heard.state, heard.state.temp
        suggestion = determine_basal(heard.glucose, temp, heard.iob, heard.meal, heard.profile)

        temp = jax.tree.map(lambda new, old: jnp.where(suggestion.sets_temp, new, old), suggestion.temp, temp)
        wanted = jnp.where(temp.duration_min > 0.0, temp.rate_U_h * MU_MIN_PER_U_H, self.basal_mU_min)
        decision = decide(
            wanted, delivered_since(observation, state.requested_mU_min), self.limits, is_known(observation)
        )
        bolus = jnp.minimum(heard.meal_mU + suggestion.units_U * MU_PER_U, self.bolus.max_mU)
        after = dataclasses.replace(
            after,
            temp=temp,
            since_bolus_min=jnp.where(bolus > 0.0, 0.0, after.since_bolus_min),
            requested_mU_min=decision.insulin_mU_min,
            requested_mU=bolus,
        )
        return after, dataclasses.replace(decision, bolus_mU=bolus)

    def forecast(self, state: _Oref0State, observation: Observation) -> DoseForecast:
        """Forecasts of four hours as oref0 shows them, under the basal rate, or without it in that of zero temp.

        The expected one is that of carbohydrate on board where there is any, else that of unannounced meals where
        glucose rises, else that of insulin on board: what dosing takes for where glucose ends.
        """
        heard = self._heard(state, observation)
        lines = shown_lines(heard.glucose, heard.iob, heard.meal, heard.profile)
        expected = lines.pop("expected")
        basal = jnp.asarray(self.basal_mU_min, expected.dtype)
        return DoseForecast(
            ahead_min=SAMPLE_MIN * jnp.arange(float(len(expected))),
            glucose_mg_dl=expected,
            insulin_mU_min=jnp.broadcast_to(basal, expected.shape),
            others_mg_dl=lines,
        )

    def _heard(self, state: _Oref0State, observation: Observation) -> _Heard:
        """Take in what was read, given and announced."""
        known = is_known(observation)
        zero = jnp.zeros_like(state.gap)
        reading = self._reading(observation, state.glucose_mg_dl[0])
        readings = _pushed(state.readings_mg_dl, jnp.where(known, reading, 0.0))
        gap = jnp.where(known, state.gap, 1.0)  # without a reading, the last one stands in its place
        glucose_mg_dl = bucketed(state.glucose_mg_dl, reading, gap)
        carbs = announced_carbs(observation)
        meal_mU = self.meal_bolus * carbs * (MU_PER_U / self.dosing.carb_ratio_g_U)
        meal_mU = self.bolus.allowed(meal_mU)
        insulin = _pushed(state.insulin_U, self._given_U(state, observation))
        waited = jnp.minimum(state.since_bolus_min + SAMPLE_MIN, _LONG_AGO_MIN)

        target = whole(jnp.clip(self._setpoint(observation), *_TARGETS_MG_DL))
        profile = dataclasses.replace(
            self.dosing, min_bg_mg_dl=target, max_bg_mg_dl=target, temptarget_set=_is_temporary(observation)
        )
        glucose = glucose_get_last(readings)
        counted, basal_U_h, replaced = insulin, profile.current_basal_U_h, state.replaced_U
        if replaced is not None:
            basal_U = self.basal_since_mU_min * SAMPLE_MIN / MU_PER_U
            replaced = _pushed(replaced, jnp.where(state.temp.duration_min > 0.0, basal_U, zero))
            share = exercise_share(profile)
            counted, basal_U_h = insulin + (1.0 - share) * replaced, basal_U_h * share
        iob = iob_total(
            jnp.concatenate([(meal_mU / MU_PER_U)[None], counted]),
            basal_U_h,
            jnp.where(meal_mU > 0.0, 0.0, waited),
            dia_h=self._action_h,
            peak_min=self.insulin_peak_min or PEAKS_MIN[self.curve],
        )
        activity = _pushed(state.activity_U_min, iob.activity_U_min)
        to_come, begins = hear(state.to_come, observation, carbs, self.sample_time_min)
        eaten = _pushed(state.carbs_g, with_rescue(begins, observation))
        meal = recent_carbs(eaten, glucose_mg_dl, activity, profile)
        left = jnp.maximum(state.temp.duration_min - SAMPLE_MIN, 0.0)
        after = _Oref0State(
            readings_mg_dl=readings,
            glucose_mg_dl=glucose_mg_dl,
            activity_U_min=activity,
            insulin_U=insulin,
            carbs_g=eaten,
            gap=jnp.where(known, zero + 1.0, jnp.minimum(state.gap + 1.0, DEVIATIONS + 1.0)),
            temp=TempBasal(rate_U_h=jnp.where(left > 0.0, state.temp.rate_U_h, 0.0), duration_min=left),
            since_bolus_min=waited,
            requested_mU_min=state.requested_mU_min,
            requested_mU=state.requested_mU,
            to_come=to_come,
            replaced_U=replaced,
        )
        return _Heard(after, glucose, iob, meal, profile, meal_mU)

    @property
    def _action_h(self) -> float:
        return self.insulin_action_min / MIN_PER_H

    def _setpoint(self, observation: Observation) -> jax.Array:
        """Target of the moment, or the person's setpoint where that is not possible."""
        setpoint = target_mg_dl(observation)
        return jnp.where(jnp.isfinite(setpoint) & (setpoint > 0.0), setpoint, self.setpoint_mg_dl)

    def _reading(self, observation: Observation, otherwise: jax.Array) -> jax.Array:
        """Reading in the range of a sensor, or another value where there is none."""
        reading = jnp.clip(observation.glucose_mg_dl, _LOWEST_MG_DL, _HIGHEST_MG_DL)
        return jnp.where(is_known(observation), reading, otherwise)

    def _given_U(self, state: _Oref0State, observation: Observation) -> jax.Array:
        """Insulin since the last sample beyond the basal rate, as the pump reports it where that is possible."""
        rate = delivered_since(observation, state.requested_mU_min)
        rate = jnp.clip(rate, self.limits.min_mU_min, self.limits.max_mU_min)
        bolus = bolus_since(observation, state.requested_mU, self.bolus)
        insulin_U: jax.Array = ((rate - self.basal_since_mU_min) * SAMPLE_MIN + bolus) / MU_PER_U
        return insulin_U
