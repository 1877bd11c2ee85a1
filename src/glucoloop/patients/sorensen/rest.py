"""Steady states of the Sorensen patient.

At rest all but one balance can be solved by hand once kidney glucose is given, so a steady state is the root of
one scalar function, the balance of the liver, which falls strictly as glucose rises. A root is bracketed,
bisected, and polished by Newton's method, so that it is exact to rounding and can be differentiated.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from glucoloop._lazy_jax import jax, jit, jnp
from glucoloop.patients.resting import shape_of_people
from glucoloop.patients.sorensen.equations import SorensenParameters, hepatic_balance, insulin_effects, renal_excretion

_HALVINGS: Final = 45
_NEWTON_STEPS: Final = 3
_KIDNEY_GLUCOSE_MG_DL: Final = (-1.0, 4000.0)
_INSULIN_MU_MIN: Final = (0.0, 1000.0)
_ROUNDING_MG_MIN: Final = 1e-9


def _root(balance: Callable[[jax.Array], jax.Array], low: jax.Array, high: jax.Array) -> jax.Array:
    """Root of a function that is positive at `low` and falls, elementwise."""

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = (low + high) / 2.0
        above = balance(middle) > 0.0
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, (low, high))
    x = jax.lax.stop_gradient((low + high) / 2.0)

    def polish(_: int, x: jax.Array) -> jax.Array:
        value, slope = jax.jvp(balance, (x,), (jnp.ones_like(x),))
        better: jax.Array = x - value / slope
        return better

    root: jax.Array = jax.lax.fori_loop(0, _NEWTON_STEPS, polish, x)
    return root


def insulin_at_rest(p: SorensenParameters, insulin_mU_min: jax.Array) -> jax.Array:
    """Insulin state `(7, ...)` under a constant infusion: every organ in proportion to the heart."""
    exchange = p.peripheral_clearance * p.T_PI / p.V_PI
    K = 1.0 - p.F_KC
    L = (1.0 - p.F_LC) * (p.Q_A + p.Q_G) / p.Q_L
    PI = 1.0 / (1.0 + exchange + p.peripheral_clearance / p.Q_P)
    PV = PI * (1.0 + exchange)
    I_H = insulin_mU_min / (p.Q_H - p.Q_B - p.Q_L * L - p.Q_K * K - p.Q_P * PV)
    return jnp.stack([I_H, I_H, I_H, I_H * L, I_H * K, I_H * PV, I_H * PI])


def _state(p: SorensenParameters, G_K: jax.Array, insulin_mU_min: jax.Array) -> tuple[jax.Array, jax.Array]:
    """State in which everything but the liver is at steady state, and the liver's balance in mg/min."""
    insulin = insulin_at_rest(p, insulin_mU_min)
    A_IHGP, A_IHGU, on_periphery, on_glucagon = insulin_effects(p, insulin)

    G_H = G_K + renal_excretion(p, G_K) / p.q_K
    G_BV = G_H - p.brain_uptake / p.q_B
    G_BI = G_BV - p.brain_uptake * p.T_B / p.v_BI
    G_G = G_H - p.gut_uptake / p.q_G
    uptake = p.basal_peripheral_uptake / p.ref_G_PI * on_periphery  # PGU / G_PI
    G_PI = G_H / (1.0 + uptake * p.T_P / p.v_PI + uptake / p.q_P)
    G_PV = G_PI * (1.0 + uptake * p.T_P / p.v_PI)
    G_L = (p.q_H * G_H + p.red_cell_uptake - p.q_B * G_BV - p.q_K * G_K - p.q_P * G_PV) / p.q_L
    N = on_glucagon * p.M_GPNR(G_H / p.ref_G_H)
    A_NHGP = (p.M_NHGP(N) - 1.0) / 2.0

    balance = p.q_A * G_H + p.q_G * G_G - p.q_L * G_L + hepatic_balance(p, G_L, A_IHGP, A_IHGU, N, A_NHGP)
    glucose = jnp.stack([G_BV, G_BI, G_H, G_G, G_L, G_K, G_PV, G_PI])
    return jnp.concatenate([glucose, insulin, jnp.stack([A_IHGP, A_IHGU, N, A_NHGP])]), balance


@jit()
def rest_under(p: SorensenParameters, insulin_mU_min: jax.Array) -> jax.Array:
    """Steady state `(19, ...)` under a constant infusion `(...)`; glucose may come out below zero."""
    shape = shape_of_people(p, insulin_mU_min)
    insulin_mU_min = jnp.broadcast_to(jnp.asarray(insulin_mU_min, float), shape)
    low, high = (jnp.full(shape, bound) for bound in _KIDNEY_GLUCOSE_MG_DL)
    G_K = _root(lambda G_K: _state(p, G_K, insulin_mU_min)[1], low, high)
    return _state(p, G_K, insulin_mU_min)[0]


@jit()
def infusion_for(p: SorensenParameters, glucose_mg_dl: jax.Array) -> jax.Array:
    """Constant infusion `(...)` in mU/min under which arterial glucose rests at the given value, or NaN."""
    infusion: jax.Array = rest_at(p, glucose_mg_dl)[0]
    return infusion


@jit()
def rest_at(p: SorensenParameters, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Constant infusion `(...)` under which arterial glucose rests at the given value, and the state `(19, ...)` there.

    Both are NaN where no infusion from 0 to 1000 mU/min does; some glucose of the state may come out below zero.
    """
    shape = shape_of_people(p, glucose_mg_dl)
    G_H = jnp.broadcast_to(jnp.asarray(glucose_mg_dl, float), shape)
    low, high = (jnp.full(shape, bound) for bound in _KIDNEY_GLUCOSE_MG_DL)
    G_K = _root(lambda G_K: G_H - G_K - renal_excretion(p, G_K) / p.q_K, low, high)
    low, high = (jnp.full(shape, bound) for bound in _INSULIN_MU_MIN)

    def balance(u: jax.Array) -> jax.Array:
        return _state(p, G_K, u)[1]

    # glucose at steady state without insulin is solvable too, though its balance may come out a hair below zero
    solvable = (balance(low) >= -_ROUNDING_MG_MIN) & (balance(high) <= 0.0)
    infusion = jnp.where(solvable, jnp.maximum(_root(balance, low, high), 0.0), jnp.nan)
    return infusion, _state(p, G_K, infusion)[0] + 0.0 * infusion
