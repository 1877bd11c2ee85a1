"""Basal-bolus therapy: a constant basal rate, and a bolus for each meal and against high glucose.

It is the therapy of people with a pump and without an algorithm, and the baseline against which the field measures
algorithms. The formula of the bolus is that of the bolus calculators of pumps. Insulin on board is the insulin of
boluses that is still under the skin, in the two depots of Hovorka et al. (2004).

References
----------
H. Zisser, L. Robinson, W. Bevier, E. Dassau, C. Ellingsen, F. J. Doyle III, L. Jovanovic, "Bolus calculator: a review
of four 'smart' insulin pumps", Diabetes Technol. Ther. 10(6), 2008, 441-444.
The rules of 500 and 1800 are those of `glucoloop.therapy`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked, is_traced
from glucoloop.component.effects import DOSES_BY_PROFILE, Need
from glucoloop.component.setting import About
from glucoloop.control.decision import announced_carbs, bolus_since, decide, delivered_since, is_known
from glucoloop.control.design_case import DesignCase, check_number, check_rate, check_sample_time
from glucoloop.control.part import ByProfile, CarbRatio, CorrectionFactor
from glucoloop.control.protocol import Decision, Observation
from glucoloop.pumps.limits import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS, BolusLimits, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.therapy import Profile
from glucoloop.unit_guess import ACTION_TIME, CARB_RATIO, CORRECTION, GLUCOSE_BOUND, INSULIN_RATE, refuse_unusual
from glucoloop.units import MU_PER_U

_LEFT: Final = 4.744
"""Number of time constants of two equal depots in a row after which 5 % of the insulin is left: ``(1 + x) exp(-x) =
0.05``.
"""
_LONG_AGO_MIN: Final = 1e5


class BasalBolusSettings(ByProfile, name="basal-bolus"):
    """Basal rate, and boluses for announced meals and against high glucose, by the usual formula."""

    sources = ("zisser2008",)

    carb_ratio_g_U: CarbRatio = 0.0
    correction_mg_dl_U: CorrectionFactor = 0.0
    insulin_on_board_min: Annotated[
        float,
        About(
            "Minutes after which 5 % of a bolus is still in the subcutaneous depots.", above=0.0, quantity=ACTION_TIME
        ),
    ] = 300.0
    correction_above_mg_dl: Annotated[
        float,
        About("Reading above which a correction is given without a meal, in mg/dl.", above=0.0, quantity=GLUCOSE_BOUND),
    ] = 180.0
    correction_every_min: Annotated[
        float,
        About("Minutes since the last bolus before which no correction is given without a meal.", at_least=0.0),
    ] = 180.0

    def designed(self, case: DesignCase) -> BasalBolus:
        """Basal-bolus controller of the catalogue, for a patient's profile."""
        controller = design_basal_bolus(
            case.basal_insulin_mU_min,
            case.limits,
            carb_ratio_g_U=self.carb_ratio_g_U or None,
            correction_mg_dl_U=self.correction_mg_dl_U or None,
            insulin_on_board_min=self.insulin_on_board_min,
            correction_above_mg_dl=self.correction_above_mg_dl,
            correction_every_min=self.correction_every_min,
            bolus=case.bolus,
            sample_time_min=case.sample_time_min,
            allow_unusual=True,  # which is asked about where it is read
        )
        return controller.with_profile(case.profile)


@pytree
class _BasalBolusState:
    """State of the controller: past boluses."""

    first_mU: jax.Array
    """Insulin of boluses in the first depot under the skin."""
    second_mU: jax.Array
    """Insulin of boluses in the second depot."""
    since_min: jax.Array
    """Time since the last bolus that was asked for."""
    requested_mU: jax.Array
    """Bolus that was asked for at the last sample, used if the pump reports nothing."""


@pytree
class BasalBolus:
    """Basal rate and boluses; see `design_basal_bolus`."""

    uses: ClassVar[frozenset[Need]] = DOSES_BY_PROFILE

    basal_mU_min: jax.Array | float
    carb_ratio_g_U: jax.Array | float | None
    """Carbohydrate that 1 U covers [g/U] for everybody, or None for each person's own."""
    correction_mg_dl_U: jax.Array | float | None
    """Fall of glucose by 1 U [mg/dl/U] for everybody, or None for each person's own."""
    insulin_on_board_min: jax.Array | float
    correction_above_mg_dl: jax.Array | float
    correction_every_min: jax.Array | float
    limits: DoseLimits
    bolus: BolusLimits
    own_carb_ratio_g_U: jax.Array | None = None
    """Carbohydrate that 1 U covers by the person's profile [g/U]; None for the rule of 500 from the basal rate."""
    own_correction_mg_dl_U: jax.Array | None = None
    """Fall of glucose by 1 U by the person's profile [mg/dl/U]; None for the rule of 1800 from the basal rate."""
    sample_time_min: float = static()
    gives_boluses: ClassVar[bool] = True

    def with_basal(self, insulin_mU_min: jax.Array) -> BasalBolus:
        """The same controller for a person with the given basal rate; values from a rule follow the rate."""
        return dataclasses.replace(self, basal_mU_min=insulin_mU_min)

    def with_profile(self, profile: Profile) -> BasalBolus:
        """The same controller for a person with the given profile; settings that were given stay as they are."""
        dosed = profile.total_daily_dose_U is not None
        ratio = dosed or profile.carb_ratio_g_U is not None
        correction = dosed or profile.correction_mg_dl_U is not None
        return dataclasses.replace(
            self.with_basal(jnp.asarray(profile.basal_mU_min)),
            own_carb_ratio_g_U=profile.carb_ratio() if ratio and self.carb_ratio_g_U is None else None,
            own_correction_mg_dl_U=profile.correction_factor()
            if correction and self.correction_mg_dl_U is None
            else None,
        )

    def settled(self) -> dict[str, Any]:
        """Basal rate, carb ratio and correction factor."""
        return {
            "basal_mU_min": self.basal_mU_min,
            "carb_ratio_g_U": self.carb_ratio(),
            "correction_mg_dl_U": self.correction_factor(),
        }

    def carb_ratio(self) -> jax.Array:
        """Carbohydrate that 1 U covers [g/U]."""
        return self._known(self.carb_ratio_g_U, self.own_carb_ratio_g_U, Profile.carb_ratio)

    def correction_factor(self) -> jax.Array:
        """Fall of glucose by 1 U [mg/dl/U]."""
        return self._known(self.correction_mg_dl_U, self.own_correction_mg_dl_U, Profile.correction_factor)

    def _known(self, given: Any, own: Any, rule: Callable[[Profile], jax.Array]) -> jax.Array:
        """The value that was given, else the person's own, else that of the rule from the basal rate."""
        if given is None and own is None:
            return rule(Profile(basal_mU_min=self.basal_mU_min, setpoint_mg_dl=jnp.nan))
        return jnp.asarray(own if given is None else given)

    def init(self, observation: Observation) -> _BasalBolusState:
        """State without boluses for a long time."""
        zero = jnp.zeros_like(observation.delivered_mU_min)
        return _BasalBolusState(first_mU=zero, second_mU=zero, since_min=zero + _LONG_AGO_MIN, requested_mU=zero)

    def step(self, state: _BasalBolusState, observation: Observation) -> tuple[_BasalBolusState, Decision]:
        """Include the bolus that was delivered, and decide on the next one."""
        first, second = self._absorbed(state, bolus_since(observation, state.requested_mU, self.bolus))
        known, on_board = is_known(observation), first + second
        above = observation.glucose_mg_dl - observation.setpoint_mg_dl
        wanted = above * (MU_PER_U / self.correction_factor())
        # Insulin on board is taken off a correction and never off the insulin for a meal, which is not digested yet.
        correction = jnp.where(wanted > 0.0, jnp.maximum(wanted - on_board, 0.0), wanted)
        correction = jnp.where(known & jnp.isfinite(wanted), correction, 0.0)
        carbs = announced_carbs(observation)
        eats, for_meal = carbs > 0.0, carbs * (MU_PER_U / self.carb_ratio())
        high = known & (observation.glucose_mg_dl > self.correction_above_mg_dl)
        alone = high & (state.since_min >= self.correction_every_min)
        bolus = jnp.where(eats | alone, for_meal + correction, 0.0)
        bolus = jnp.clip(bolus, 0.0, self.bolus.max_mU)
        since = jnp.minimum(state.since_min + self.sample_time_min, _LONG_AGO_MIN)
        after = _BasalBolusState(
            first_mU=first,
            second_mU=second,
            since_min=jnp.where(bolus >= self.bolus.min_mU, self.sample_time_min, since),
            requested_mU=bolus,
        )
        basal = jnp.broadcast_to(jnp.asarray(self.basal_mU_min, bolus.dtype), bolus.shape)
        decision = decide(basal, delivered_since(observation, basal), self.limits, known)
        return after, dataclasses.replace(decision, bolus_mU=bolus)

    def _absorbed(self, state: _BasalBolusState, bolus_mU: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Content of the two depots a sample after a bolus, exact."""
        samples = self.sample_time_min * _LEFT / self.insulin_on_board_min
        left, first = jnp.exp(-samples), state.first_mU + bolus_mU
        return first * left, (state.second_mU + first * samples) * left


@checked
def design_basal_bolus(
    basal_mU_min: float,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    carb_ratio_g_U: float | None = None,
    correction_mg_dl_U: float | None = None,
    insulin_on_board_min: float = BasalBolusSettings.insulin_on_board_min,
    correction_above_mg_dl: float = BasalBolusSettings.correction_above_mg_dl,
    correction_every_min: float = BasalBolusSettings.correction_every_min,
    bolus: BolusLimits = DEFAULT_BOLUS_LIMITS,
    sample_time_min: float = 5.0,
    allow_unusual: bool = False,
) -> BasalBolus:
    """Controller for basal-bolus therapy.

    The rate is always the basal rate. With a meal that is announced the bolus is::

        carbs / CR + max(0, (G - target) / CF - IOB)      where G is above the target
        carbs / CR + (G - target) / CF                    where it is below

    and never below 0. Without a meal, the second term is given if G is above a bound and no bolus was given for some
    time.

    ============  ==============================================  ==========================
    variable      meaning                                         setting
    ============  ==============================================  ==========================
    ``carbs``     carbohydrate as it was announced, g
    ``CR``        carbohydrate that 1 U covers, g/U               ``carb_ratio_g_U``
    ``G``         the reading, mg/dl; without one no correction
    ``CF``        fall of glucose by 1 U, mg/dl/U                 ``correction_mg_dl_U``
    ``IOB``       insulin of boluses still under the skin, U      ``insulin_on_board_min``
    ============  ==============================================  ==========================

    Parameters
    ----------
    basal_mU_min : float
        The person's basal rate.
    limits : DoseLimits
        Limits of the basal rate.
    carb_ratio_g_U : float, optional
        Carbohydrate that 1 U covers; by default 500 g over the total daily dose in U, which is twice the basal rate.
    correction_mg_dl_U : float, optional
        Fall of glucose by 1 U; by default 1800 mg/dl over the total daily dose in U.
    insulin_on_board_min : float
        Time after which 5 % of a bolus is still under the skin.
    correction_above_mg_dl : float
        Reading above which a correction is given without a meal.
    correction_every_min : float
        Shortest time from the last bolus to such a correction.
    bolus : BolusLimits
        Limits of the pump; no larger bolus is asked for.
    allow_unusual : bool
        Whether a basal rate, a ratio or a correction is accepted that looks like another unit.

    Raises
    ------
    ValueError
        For a basal rate outside the limits, a setting that is not above 0 and finite, or an implausible value.

    Examples
    --------
    >>> controller = design_basal_bolus(6.73)
    >>> round(float(controller.carb_ratio()), 1), round(float(controller.correction_factor()))
    (25.8, 93)
    """
    check_sample_time(sample_time_min)
    check_rate("basal", basal_mU_min, limits)
    check_number("carb ratio", carb_ratio_g_U, "g/U")
    check_number("correction factor", correction_mg_dl_U, "mg/dl/U")
    check_number("time of insulin on board", insulin_on_board_min, "min")
    check_number("bound of corrections", correction_above_mg_dl, "mg/dl")
    if not is_traced(correction_every_min) and not 0.0 <= correction_every_min < math.inf:
        raise Refusal(
            f"corrections every {correction_every_min:g} min are not possible; give a finite time of 0 or more"
        )
    amounts = {
        "basal_mU_min": (basal_mU_min, INSULIN_RATE),
        "carb_ratio_g_U": (carb_ratio_g_U, CARB_RATIO),
        "correction_mg_dl_U": (correction_mg_dl_U, CORRECTION),
    }
    for name, (amount, quantity) in amounts.items():
        if amount is not None and not allow_unusual and not is_traced(amount):
            refuse_unusual(amount, quantity, name)
    return BasalBolus(
        basal_mU_min=basal_mU_min,
        carb_ratio_g_U=carb_ratio_g_U,
        correction_mg_dl_U=correction_mg_dl_U,
        insulin_on_board_min=insulin_on_board_min,
        correction_above_mg_dl=correction_above_mg_dl,
        correction_every_min=correction_every_min,
        limits=limits,
        bolus=bolus,
        sample_time_min=sample_time_min,
    )
