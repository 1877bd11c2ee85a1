"""Basal-bolus therapy: a constant basal rate, and a bolus for each meal and against high glucose.

It is the therapy of people with a pump and without an algorithm, and the baseline against which the field measures
algorithms. The formula of the bolus is that of the bolus calculators of pumps. Insulin on board is the insulin of
boluses that is still subcutaneous, in the two depots of Hovorka et al. (2004).

References
----------
H. Zisser, L. Robinson, W. Bevier, E. Dassau, C. Ellingsen, F. J. Doyle III, L. Jovanovic, "Bolus calculator: a review
of four 'smart' insulin pumps", Diabetes Technol. Ther. 10(6), 2008, 441-444.
The rules of 500 and 1800 are those of `glucoloop.therapy`.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.pytree_component import HOST, derived
from glucoloop.component.setting import About
from glucoloop.control.decision import announced_carbs, bolus_since, decide, delivered_since, is_known, target_mg_dl
from glucoloop.control.part import CarbRatio, CorrectionFactor, OfPerson
from glucoloop.control.protocol import Decision, Observation
from glucoloop.unit_guess import ACTION_TIME, GLUCOSE_BOUND
from glucoloop.units import MU_PER_U

_LEFT: Final = 4.744
"""Number of time constants of two equal depots in a row after which 5 % of the insulin is left: ``(1 + x) exp(-x) =
0.05``.
"""
_LONG_AGO_MIN: Final = 1e5


@pytree
class _BasalBolusState:
    """State of the controller: past boluses."""

    first_mU: jax.Array
    """Insulin of boluses in the first subcutaneous depot."""
    second_mU: jax.Array
    """Insulin of boluses in the second depot."""
    since_min: jax.Array
    """Time since the last bolus that was requested."""
    requested_mU: jax.Array
    """Bolus that was requested at the last sample, used if the pump reports nothing."""


class BasalBolus(OfPerson, name="basal-bolus"):
    """Basal rate, and boluses for announced meals and against high glucose, by the usual formula.

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
    ``IOB``       insulin of boluses still subcutaneous, U         ``insulin_on_board_min``
    ============  ==============================================  ==========================

    Examples
    --------
    >>> from glucoloop.therapy import Profile
    >>> controller = BasalBolus().of_person(Profile(basal_mU_min=6.73, setpoint_mg_dl=110.0))
    >>> round(float(controller.carbs_per_U), 1), round(float(controller.fall_per_U))
    (25.8, 93)
    """

    sources = ("zisser2008",)

    carb_ratio_g_U: Annotated[CarbRatio, HOST] = 0.0
    correction_mg_dl_U: Annotated[CorrectionFactor, HOST] = 0.0
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

    @derived
    def carbs_per_U(self) -> Any:
        """Carbohydrate that 1 U covers [g/U], as it was given or by the profile."""
        return self.carb_ratio_g_U or self._person.carb_ratio()

    @derived
    def fall_per_U(self) -> Any:
        """Fall of glucose by 1 U [mg/dl/U], as it was given or by the profile."""
        return self.correction_mg_dl_U or self._person.correction_factor()

    def settled(self) -> dict[str, Any]:
        """Basal rate, carb ratio and correction factor."""
        return {
            "basal_mU_min": self.basal_mU_min,
            "carb_ratio_g_U": self.carbs_per_U,
            "correction_mg_dl_U": self.fall_per_U,
        }

    def init(self, observation: Observation) -> _BasalBolusState:
        """State without boluses for a long time."""
        zero = jnp.zeros_like(observation.delivered_mU_min)
        return _BasalBolusState(first_mU=zero, second_mU=zero, since_min=zero + _LONG_AGO_MIN, requested_mU=zero)

    def step(self, state: _BasalBolusState, observation: Observation) -> tuple[_BasalBolusState, Decision]:
        """Include the bolus that was delivered, and decide on the next one."""
        first, second = self._absorbed(state, bolus_since(observation, state.requested_mU, self.bolus))
        known, on_board = is_known(observation), first + second
        above = observation.glucose_mg_dl - target_mg_dl(observation)
        wanted = above * (MU_PER_U / self.fall_per_U)
        # Insulin on board is taken off a correction and never off the insulin for a meal, which is not digested yet.
        correction = jnp.where(wanted > 0.0, jnp.maximum(wanted - on_board, 0.0), wanted)
        correction = jnp.where(known & jnp.isfinite(wanted), correction, 0.0)
        carbs = announced_carbs(observation)
        eats, for_meal = carbs > 0.0, carbs * (MU_PER_U / self.carbs_per_U)
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
