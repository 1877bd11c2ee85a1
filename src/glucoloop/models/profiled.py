"""Internal model of a person who is known by a profile: the nominal person's equations with insulin and meals scaled.

With the nominal person's equations ``x' = f(x, u)`` and the effect ``E m`` of glucose that appears at a rate m from
meals, a person with the basal rate u_b is::

    x' = f(x, u_n + g_u (u - u_b)) + E (g_m m + d)

where u_n is the nominal basal rate and d what no meal explains, as appearance in the nominal person. The gain g_u is
that of the correction factors, ``CF / CF_n``, and with it ``g_m = g_u CR_n / CR`` is that of the carbohydrate ratios:
insulin lowers glucose, and carbohydrate raises it, as the profile has it. CF_n and CR_n are those of the nominal model
itself, titrated on it as `build.titration` titrates people. What the profile does not hold is told from basal
rate and weight: who needs more insulin at steady state answers less to it, and who weighs more has more room for
glucose.

Insulin is not accepted to do next to nothing, since a model in which it does gives far too much of it. With the total
daily dose D, by default twice the daily basal dose, the numbers of the profile are taken to be at least shares of those
by the rules of Walsh et al. (2011)::

    CF = max(CF_profile, min(0.43 * 1800 / D, CF_n u_n / u_b))
    CR = max(CR_profile, min(0.29 * 500 / D, CR_n u_n / u_b))

or as little as the nominal model has, scaled to the person's basal rate: in that of the UVA/Padova simulator a unit
does 0.16 of what the rule of 1800 says.
The shares are the minimum of a first titration of virtual people. Of 150 others of boiroux2017 and of wilinska2010
each, with profiles 15 % wrong, 5 to 25 % have lower factors, down to 0.02, and fewer than 5 % lower ratios. From above
nothing is bounded: who is taken to be too sensitive is given too little insulin, and not too much.

The equations are advanced by an exponential Runge-Kutta method of second order about the Jacobian J at steady state,
which is exact where they are linear, as subcutaneous insulin is, so that steps of half an hour are possible::

    a = x + h phi_1(hJ) x',    x(t + h) = a + h phi_2(hJ) (x'(a) - x'(x) - J (a - x))

References
----------
M. Hochbruck, A. Ostermann, "Exponential integrators", Acta Numerica 19, 2010, 209-286 (the method ETD2RK).
J. Walsh, R. Roberts, T. Bailey, "Guidelines for optimal bolus calculator settings in adults", J. Diabetes Sci. Technol.
5(1), 2011, 129-135 (the rules of 500 and 1800).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final, TypeAlias

from glucoloop._lazy_jax import jax, jnp, np, npt, scipy
from glucoloop._pytree import pytree
from glucoloop.models.nonlinear import Equations, reading_of
from glucoloop.models.state_space import LinearModel
from glucoloop.refusal import Refusal
from glucoloop.therapy import CARB_RULE, CORRECTION_RULE, Profile
from glucoloop.units import MG_PER_G, MIN_PER_H, MU_PER_U

Matrix: TypeAlias = "npt.NDArray[np.float64]"

MEAL_G: Final = 50.0
ACTION_MIN: Final = 300.0
"""Meal, and time after which insulin has acted, of the titration of `build.titration`."""
_MIN_CORRECTION_SHARE: Final = 0.43
"""Minimum correction factor that is accepted, relative to that by the rule of 1800."""
_MIN_CARB_SHARE: Final = 0.29
"""Minimum carbohydrate ratio that is accepted, relative to that by the rule of 500."""
_MIN_U: Final = 0.25
_MAX_U: Final = 50.0
_HALVINGS: Final = 20
_MIN_SHARE: Final = 0.05
"""Part of glucose at steady state below which a model is not carried: of 120 mg/dl, 6."""


@pytree
class GutCompartments:
    """Two compartments in a row with one time constant, as in Hovorka et al. (2004); contents in mg, ``(2,)``."""

    time_to_peak_min: jax.Array | float

    def after(self, content_mg: jax.Array, minutes: jax.typing.ArrayLike) -> jax.Array:
        """Contents after some minutes without eating."""
        z = minutes / self.time_to_peak_min
        left = jnp.exp(-z)
        first, second = content_mg[0], content_mg[1]
        return jnp.stack([left * first, left * (second + z * first)])

    def appeared(self, minutes: jax.typing.ArrayLike) -> jax.Array:
        """Share of a meal that has appeared some minutes after it was eaten."""
        z = jnp.asarray(minutes) / self.time_to_peak_min
        return 1.0 - (1.0 + z) * jnp.exp(-z)

    def appearance_mg_min(self, content_mg: jax.Array, minutes: jax.typing.ArrayLike) -> jax.Array:
        """Mean rate at which glucose appears over some minutes."""
        return jnp.sum(content_mg - self.after(content_mg, minutes), axis=0) / minutes


@pytree
class Step:
    """Matrices of a step of the method; a leading axis is that of several steps."""

    minutes: Any
    first: Any
    """``h phi_1(hJ)``, ``(n, n)``."""
    second: Any
    """``h phi_2(hJ)``, ``(n, n)``."""


@pytree
class ProfiledModel:
    """A person by profile; see the head of the file."""

    nominal: Equations
    J: jax.Array
    """Jacobian of the nominal equations at steady state, ``(n, n)``."""
    E: jax.Array
    """Effect of appearance, ``(n,)`` per mg/min."""
    least: jax.Array
    """Bound ``(n,)`` below which no state of glucose is taken, since equations may have a pole below zero."""
    own_carb_ratio_g_U: jax.Array | float
    """CR_n; NaN where no bolus is right for a meal."""
    own_correction_mg_dl_U: jax.Array | float
    """CF_n, the model's own correction factor."""
    own_weight_kg: jax.Array | float
    """Weight of the nominal person; NaN where it is not known."""
    basal_mU_min: Any
    insulin_gain: Any = 1.0
    """g_u, gain of insulin relative to the nominal person's."""
    meal_gain: Any = 1.0
    """g_m, the same of meals."""
    min_share: Any = 1.0
    """Minimum numbers of a profile that are accepted, relative to the shares of the head of the file."""

    @property
    def correction_mg_dl_U(self) -> Any:
        """Correction factor of the person that the model believes."""
        return self.insulin_gain * self.own_correction_mg_dl_U

    @property
    def basal_effect_mg_dl_min(self) -> Any:
        """Fall of glucose in a minute by the basal rate of the person, by the correction factor."""
        return self.correction_mg_dl_U * self.basal_mU_min / MU_PER_U

    def with_profile(self, profile: Profile) -> ProfiledModel:
        """Model of the person, or of people ``(people,)``, with a profile."""
        basal = jnp.asarray(profile.basal_mU_min, float)
        unknown = jnp.full_like(basal, jnp.nan)
        ratio, factor, weight = (
            unknown if value is None else jnp.asarray(value, float)
            for value in (profile.carb_ratio_g_U, profile.correction_mg_dl_U, profile.weight_kg)
        )
        # a number that is not known stays NaN
        daily_U, by_basal = profile.daily_dose_U(), self.nominal.insulin_mU_min / basal
        own_ratio, own_factor = self.own_carb_ratio_g_U * by_basal, self.own_correction_mg_dl_U * by_basal
        min_ratio, min_factor = (
            self.min_share * share / daily_U
            for share in (_MIN_CARB_SHARE * CARB_RULE, _MIN_CORRECTION_SHARE * CORRECTION_RULE)
        )
        ratio = jnp.maximum(ratio, jnp.fmin(min_ratio, own_ratio))
        factor = jnp.maximum(factor, jnp.fmin(min_factor, own_factor))
        by_factor = factor / self.own_correction_mg_dl_U
        insulin_gain = _first_known(by_factor, by_basal, 1.0)
        by_ratio, by_weight = insulin_gain * self.own_carb_ratio_g_U / ratio, self.own_weight_kg / weight
        return dataclasses.replace(
            self,
            basal_mU_min=basal,
            insulin_gain=insulin_gain,
            meal_gain=_first_known(by_ratio, by_weight, 1.0),
        )

    def step_of(self, minutes: float) -> Step:
        """Matrices of a step of so many minutes."""
        J = np.asarray(self.J, float)
        n = len(J)
        one, none = np.eye(n), np.zeros((n, n))
        blocks = np.block([[minutes * J, one, none], [none, none, one], [none, none, none]])
        exponential: Matrix = scipy.linalg.expm(blocks)
        return Step(
            minutes=minutes, first=minutes * exponential[:n, n : 2 * n], second=minutes * exponential[:n, 2 * n :]
        )

    def steps_of(self, minutes: Sequence[float]) -> Step:
        """Matrices of several steps, stacked."""
        known = {length: self.step_of(length) for length in set(minutes)}
        steps = [known[length] for length in minutes]
        return Step(
            **{
                name: jnp.asarray(np.stack([getattr(step, name) for step in steps]))
                for name in ("minutes", "first", "second")
            }
        )

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array, flux_mg_min: jax.Array, step: Step) -> jax.Array:
        """State a step on, under a held rate of insulin and held appearance in the nominal person."""
        u = self.nominal.insulin_mU_min + self.insulin_gain * (insulin_mU_min - self.basal_mU_min)
        fasting = self.nominal.derivative(x, u)
        middle = jnp.maximum(x + step.first @ (fasting + self.E * flux_mg_min), self.least)
        later: jax.Array = self.nominal.derivative(middle, u) - fasting - self.J @ (middle - x)
        return jnp.maximum(middle + step.second @ later, self.least)

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose of a state."""
        return self.nominal.glucose_mg_dl(x)

    def reading_mg_dl(self, x: jax.Array) -> jax.Array:
        """Reading of a sensor without noise."""
        return reading_of(self.nominal)(x)

    def fed_states(self) -> tuple[int, ...]:
        """Numbers of the states that appearance reaches: those of glucose, and not those of insulin."""
        reached, J = np.asarray(self.E) != 0.0, np.asarray(self.J) != 0.0
        for _ in range(len(J)):
            reached = reached | (J @ reached)
        return tuple(np.flatnonzero(reached).tolist())


def _first_known(*values: Any) -> jax.Array:
    """The first of some values that is a number, elementwise."""
    *others, last = values
    for value in reversed(others):
        last = jnp.where(jnp.isfinite(value), value, last)
    return jnp.asarray(last)


def profiled_model(
    nominal: Equations, linear: LinearModel, gut: GutCompartments, weight_kg: float | None, min_share: float = 1.0
) -> ProfiledModel:
    """Model of the nominal person, to be given a profile.

    Parameters
    ----------
    nominal : NonlinearModel
        The nominal person's equations, at steady state.
    linear : LinearModel
        The same linearised at steady state, whose disturbance is appearance in mg/min.
    gut : GutCompartments
        Gut with which the model's carbohydrate ratio is titrated.
    weight_kg : float, optional
        The nominal person's weight.
    min_share : float
        Minimum numbers of a profile that are accepted, relative to the shares of the head of the file.

    Raises
    ------
    ValueError
        For a linear model without a disturbance, or a person whose glucose insulin does not lower.
    """
    if linear.Psi is None:
        raise Refusal("the linear model does not say what a meal does; give one with a disturbance, Psi")
    x, u = jnp.asarray(nominal.state, float), jnp.asarray(nominal.insulin_mU_min, float)
    model = ProfiledModel(
        nominal=nominal,
        J=jax.jacfwd(nominal.derivative)(x, u),
        E=jnp.zeros_like(x),
        least=jnp.full_like(x, -jnp.inf),
        own_carb_ratio_g_U=math.nan,
        own_correction_mg_dl_U=math.nan,
        own_weight_kg=math.nan if weight_kg is None else float(weight_kg),
        basal_mU_min=u,
        min_share=min_share,
    )
    E = np.linalg.solve(model.step_of(linear.sample_time_min).first, np.asarray(linear.Psi, float))
    # What rounding alone leaves is no effect.
    model = dataclasses.replace(model, E=jnp.where(np.abs(E) > 1e-9 * np.abs(E).max(), E, 0.0))
    of_glucose = np.isin(np.arange(x.size), model.fed_states())
    return _titrated(dataclasses.replace(model, least=jnp.where(of_glucose, _MIN_SHARE * x, -jnp.inf)), gut)


def _titrated(model: ProfiledModel, gut: GutCompartments) -> ProfiledModel:
    """The model with its own carbohydrate ratio and correction factor."""
    minutes = model.nominal.sample_time_min
    step, rest = model.step_of(minutes), jnp.asarray(model.nominal.state, float)
    basal = float(model.basal_mU_min)

    @jax.jit
    def trajectory(bolus_U: jax.Array, carbs_g: jax.Array) -> jax.Array:
        def sample(carry: tuple[jax.Array, jax.Array], bolus_mU: jax.Array) -> Any:
            x, content = carry
            flux = gut.appearance_mg_min(content, minutes)
            x = model.advance(x, model.basal_mU_min + bolus_mU / minutes, flux, step)
            return (x, gut.after(content, minutes)), model.glucose_mg_dl(x)

        boluses = jnp.zeros(math.ceil(ACTION_MIN / minutes)).at[0].set(MU_PER_U * bolus_U)
        content = jnp.stack([MG_PER_G * carbs_g, jnp.zeros_like(carbs_g)])
        glucose: jax.Array = jax.lax.scan(sample, (rest, content), boluses)[1]
        return glucose

    start, bolus_U = float(model.glucose_mg_dl(rest)), MIN_PER_H / MU_PER_U * basal
    factor = (start - float(jnp.min(trajectory(jnp.asarray(bolus_U), jnp.asarray(0.0))))) / bolus_U
    if not factor > 0.0:
        raise Refusal(
            f"an hour's basal insulin, {bolus_U:g} U, does not lower the model's glucose; choose another patient, or "
            "a controller without a model"
        )

    def above(bolus_U: float) -> bool:
        return bool(trajectory(jnp.asarray(bolus_U), jnp.asarray(MEAL_G))[-1] > start)

    low, high, ratio = _MIN_U, _MIN_U, math.nan
    # From below, since a dose far too large leaves the range in which the equations hold.
    while high < _MAX_U and above(high):
        low, high = high, 1.5 * high
    if low < high <= _MAX_U:
        for _ in range(_HALVINGS):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if above(middle) else (low, middle)
        ratio = MEAL_G / math.sqrt(low * high)
    return dataclasses.replace(model, own_carb_ratio_g_U=ratio, own_correction_mg_dl_U=factor)
