"""PID control with insulin feedback, as in hybrid closed loops: the rate falls by insulin that is still to act.

G. M. Steil et al., "The effect of insulin feedback on closed loop glucose control", J. Clin. Endocrinol. Metab. 96(5),
2011, 1402-1408. J. L. Ruiz et al., "Effect of insulin feedback on closed-loop glucose control: a crossover study",
J. Diabetes Sci. Technol. 6(5), 2012, 1123-1130 (the model of insulin and the feedback gains). The derivative gain from
the daily dose by the rule of 1500, and the derivative time of 90 min, are those of public implementations of
proportional-derivative control for the artificial pancreas, which name no paper; the integral time is a choice.

The bolus of a meal is that of the person's carbohydrate ratio, as the wearer of a hybrid closed loop gives it.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Final

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop.component.effects import AHEAD, ANNOUNCEMENTS, CARB_RATIO, CORRECTION, Need
from glucoloop.component.pytree_component import HOST, derived
from glucoloop.component.setting import About
from glucoloop.control.decision import announced_carbs, bolus_since, decide, delivered_since, is_known, rate_at_start
from glucoloop.control.part import CarbRatio, MealShare, OfPerson
from glucoloop.control.pid import ROUNDING
from glucoloop.control.protocol import Decision, Observation
from glucoloop.units import MU_PER_U

_TIME_CONSTANTS_MIN: Final = (50.0, 70.0, 55.0)
"""Time constants of subcutaneous insulin, in plasma and at its effect, each a lag of gain 1. Ruiz et al. print the
matrix for steps of 1 min, in which 0.9802, 0.98582 and 0.98198 are ``exp(-1/50)``, ``exp(-1/70)`` and ``exp(-1/55)``.
"""
FEEDBACK: Final = (0.64935, 0.34128, 0.0093667)
"""Gains of the feedback of the three, Ruiz et al."""
_DERIVATIVE_RULE: Final = 1500.0
"""Fall of glucose [mg/dl] by 1 U, times the total daily dose [U], from which the derivative gain follows."""
_MAX_MG_DL: Final = 1000.0
"""Largest difference of glucose that enters the rate; no sensor reads so far from a setpoint."""


def insulin_lags(sample_time_min: float) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Exact step of the model of insulin: the matrix ``(3, 3)`` of its states, and the effect ``(3,)`` of a rate."""
    from scipy.linalg import expm

    rates = 1.0 / np.asarray(_TIME_CONSTANTS_MIN)
    A = np.diag(-rates) + np.diag(rates[1:], -1)
    Phi = expm(A * sample_time_min)
    return Phi, 1.0 - Phi.sum(axis=1)  # a lasting rate is met by states that equal it


@pytree
class _PIDIFBState:
    """Last reading, integral part, modelled insulin, and what was asked for and is in force."""

    last_mg_dl: jax.Array
    integral_mU_min: jax.Array
    insulin_mU_min: jax.Array
    """(3, ...) modelled subcutaneous insulin, in plasma and at its effect, as the rate that would hold it."""
    rate_mU_min: jax.Array
    """Rate in force."""
    requested_mU_min: jax.Array
    """Last rate that was asked for, within the range of the pump."""
    requested_mU: jax.Array
    """Bolus that was asked for at the last sample, used if the pump reports nothing."""


class PIDIFB(OfPerson, name="pid-ifb"):
    """PID with insulin feedback and meal boluses, by the total daily dose, as in hybrid closed loops.

    With the error ``e = y - r`` the rate is::

        v = K_P e_k + I_k + K_P (T_D / T) (y_k - y_(k-1)),    I_k = I_(k-1) + K_P (T / T_I) e_k
        u = (1 + g_1 + g_2 + g_3) v - g_1 I_SC - g_2 I_P - g_3 I_EFF,    K_P = k (TDD / 1500) / T_D

    where the modelled insulin follows the delivered one, boluses included: 50 I_SC' = u - I_SC, 70 I_P' = I_SC - I_P,
    55 I_EFF' = I_P - I_EFF. At rest all are the rate, so that the feedback changes no rate that lasts. The integral
    begins with the basal rate, keeps the range of the pump, and waits where the rate is cut or at a limit. With a meal
    that is announced a bolus of carbs / CR is given, and the feedback takes the insulin of the bolus into account.

    ===================  ==========================================  ======================
    variable             meaning                                     setting
    ===================  ==========================================  ======================
    ``TDD``              total daily dose, U                         ``profile``
    ``k``                factor on the gain                          ``gain``
    ``T_I, T_D``         integral, derivative time, min              ``integral_time_min``, ``derivative_time_min``
    ``g_1, g_2, g_3``    0.64935, 0.34128, 0.0093667, times          ``feedback``
    ``CR``               carbohydrate that 1 U covers, g/U           ``carb_ratio_g_U``
    ===================  ==========================================  ======================

    Examples
    --------
    >>> from glucoloop.therapy import Profile
    >>> controller = PIDIFB().of_person(Profile(basal_mU_min=15.0, setpoint_mg_dl=110.0, total_daily_dose_U=45.0))
    >>> round(float(controller.proportional()), 3)
    0.333
    """

    sources = ("steil2011", "ruiz2012")

    gain: Annotated[float, About("Factor on the gain that follows from the total daily dose.", above=0.0)] = 1.0
    integral_time_min: Annotated[float, About("Integral time T_I, in minutes.", above=0.0)] = 450.0
    derivative_time_min: Annotated[float, About("Derivative time T_D, in minutes.", above=0.0)] = 90.0
    feedback: Annotated[
        float,
        About("Factor on the gains of the insulin feedback; 0: a PID controller.", at_least=0.0, at_most=5.0),
        HOST,
    ] = 1.0
    carb_ratio_g_U: CarbRatio = 0.0
    meal_bolus: MealShare = 1.0

    def uses(self) -> frozenset[Need]:
        """Needs that the controller meets; announcements where meals have a bolus."""
        return super().uses() - {CORRECTION} - frozenset(() if self.meal_bolus else {ANNOUNCEMENTS, AHEAD, CARB_RATIO})

    @derived
    def daily_dose_U(self) -> jax.Array:
        """The person's total daily dose."""
        return self._person.daily_dose_U()

    @derived
    def carbs_per_U(self) -> Any:
        """Carbohydrate that 1 U covers [g/U], as it was given or by the profile."""
        return self.carb_ratio_g_U or self._person.carb_ratio()

    @derived
    def feedback_gains(self) -> Any:
        """Gains ``(3,)`` of the feedback."""
        return self.feedback * np.asarray(FEEDBACK)

    def settled(self) -> dict[str, Any]:
        """Gain in mU/min per mg/dl, total daily dose and carbohydrate ratio."""
        return {
            "gain": self.proportional(),
            "daily_dose_U": self.daily_dose_U,
            "carb_ratio_g_U": self.carbs_per_U,
        }

    def proportional(self) -> jax.Array:
        """Proportional gain [mU/min per mg/dl]: a rise is met by the insulin that the rule of 1500 gives against it."""
        return jnp.asarray(self.gain * self.daily_dose_U * MU_PER_U / _DERIVATIVE_RULE / self.derivative_time_min)

    def init(self, observation: Observation) -> _PIDIFBState:
        """State in which the first reading calls for the basal rate, after the rate in force for a long time."""
        reading = jnp.where(is_known(observation), observation.glucose_mg_dl, observation.setpoint_mg_dl)
        rate = rate_at_start(observation, self.limits.min_mU_min)
        return _PIDIFBState(
            last_mg_dl=reading,
            integral_mU_min=jnp.broadcast_to(jnp.asarray(self.basal_mU_min, rate.dtype), rate.shape),
            insulin_mU_min=jnp.stack([rate] * 3),
            rate_mU_min=rate,
            requested_mU_min=rate,
            requested_mU=jnp.zeros_like(rate),
        )

    def step(self, state: _PIDIFBState, observation: Observation) -> tuple[_PIDIFBState, Decision]:
        """Follow the delivered insulin, and answer the reading and the insulin that is still to act.

        The integral waits where the rate is at a limit of the pump, or was cut, and would go further that way.
        """
        delivered = delivered_since(observation, state.rate_mU_min)
        given = jnp.where((delivered >= 0.0) & (delivered <= self.limits.max_mU_min), delivered, state.requested_mU_min)
        given = given + bolus_since(observation, state.requested_mU, self.bolus) / self.sample_time_min
        Phi, Gamma = insulin_lags(self.sample_time_min)
        insulin = jnp.stack(
            [sum((Phi[i, j] * state.insulin_mU_min[j] for j in range(i + 1)), Gamma[i] * given) for i in range(3)]
        )
        known = is_known(observation)
        y = jnp.where(known, observation.glucose_mg_dl, state.last_mg_dl)
        error = jnp.clip(y - observation.setpoint_mg_dl, -_MAX_MG_DL, _MAX_MG_DL)
        rise = jnp.clip(y - state.last_mg_dl, -_MAX_MG_DL, _MAX_MG_DL)
        gain = self.proportional()
        grown = state.integral_mU_min + gain * error * (self.sample_time_min / self.integral_time_min)
        beta_cell = gain * (error + self.derivative_time_min / self.sample_time_min * rise) + grown
        fed_back = sum((self.feedback_gains[i] * insulin[i] for i in range(3)), jnp.zeros(()))
        wanted = (1.0 + jnp.sum(jnp.asarray(self.feedback_gains))) * beta_cell - fed_back
        wanted = jnp.where(known, wanted, state.requested_mU_min)
        finite, least, most = jnp.isfinite(wanted), self.limits.min_mU_min, self.limits.max_mU_min
        requested = jnp.clip(jnp.where(finite, wanted, state.requested_mU_min), least, most)
        cut, rounding = state.requested_mU_min - delivered, ROUNDING * most
        waits = (error > 0.0) & ((wanted >= most) | (cut > rounding))
        waits = waits | ((error < 0.0) & ((wanted <= least) | (cut < -rounding)))
        grown = jnp.where(known & finite & ~waits, jnp.clip(grown, least, most), state.integral_mU_min)
        for_meal = self.meal_bolus * announced_carbs(observation) * (MU_PER_U / self.carbs_per_U)
        bolus = jnp.clip(for_meal, 0.0, self.bolus.max_mU)
        decision = decide(wanted, delivered, self.limits, known)
        after = _PIDIFBState(
            last_mg_dl=y,
            integral_mU_min=grown,
            insulin_mU_min=insulin,
            rate_mU_min=delivered,
            requested_mU_min=requested,
            requested_mU=bolus,
        )
        return after, dataclasses.replace(decision, bolus_mU=bolus)
