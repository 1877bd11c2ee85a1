"""Steady states of the Hovorka patient, in closed form.

Insulin and its effects rest in proportion to the infusion. With them the balance of glucose is linear in Q1 between the
thresholds of uptake and renal excretion, so that the glucose which a rate holds is the solution on one of three pieces.
Conversely, at a given glucose the balance is a quadratic in plasma insulin::

    (EGP_0 (1 - S_IE I) - L(G)) (k_12 + S_ID I) - Q1 S_IT S_ID I^2 = 0

where L is what leaves without insulin, ``F_01^c + F_R``. Its left side falls from ``(EGP_0 - L) k_12`` at I = 0, so it
has one root of 0 or more where production without insulin is at least that loss, and none otherwise. At the root
``1 - S_IE I`` is positive, so production need not be kept at 0 or above there.
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp

from glucoloop.patients.hovorka.equations import (
    MG_DL_PER_MMOL_L,
    HovorkaParameters,
    hepatic_production,
    renal_excretion,
    uptake_without_insulin,
)

_ROUNDING: Final = 1e-12
"""Fraction of production by which it may seem to fall short of the loss where a person rests without insulin."""


def _people(p: HovorkaParameters, given: jax.Array | float) -> tuple[int, ...]:
    """Shape of the people: whatever constants vary among them."""
    return jnp.broadcast_shapes(jnp.shape(given), *(jnp.shape(constant) for constant in jax.tree.leaves(p)))


def insulin_at_rest(p: HovorkaParameters, insulin_mU_min: jax.Array) -> jax.Array:
    """S1, S2, I, x1, x2, x3 `(6, ...)` under a constant infusion."""
    depot = insulin_mU_min * p.t_maxI
    I = insulin_mU_min / (p.k_e * p.insulin_volume_l)
    return jnp.stack(jnp.broadcast_arrays(depot, depot, I, p.S_IT * I, p.S_ID * I, p.S_IE * I))


def _glucose_at_rest(p: HovorkaParameters, effects: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Q1 and Q2 under given effects: the balance of Q1 solved below, between and above the two thresholds."""
    x1, x2, x3 = effects
    V_G, uptake, k_R = p.glucose_volume_l, p.F_01 * p.weight_kg, p.renal_clearance
    made = hepatic_production(p, x3)
    disposal = x1 * x2 / (p.k_12 + x2)  # what insulin disposes of, per Q1
    scarce = made / (uptake / (p.uptake_threshold * V_G) + disposal)
    plentiful = (made - uptake + k_R * p.renal_threshold * V_G) / (k_R + disposal)
    disposed = disposal > 0.0
    between = (made - uptake) / jnp.where(disposed, disposal, 1.0)
    excreting = plentiful >= p.renal_threshold * V_G
    Q1 = jnp.where(scarce <= p.uptake_threshold * V_G, scarce, jnp.where(excreting, plentiful, between))
    return Q1, x1 * Q1 / (p.k_12 + x2)


def _state(p: HovorkaParameters, Q1: jax.Array, Q2: jax.Array, insulin: jax.Array) -> jax.Array:
    return jnp.concatenate([jnp.stack([Q1, Q2, Q1 / p.glucose_volume_l]), insulin])


@jax.jit
def rest_under(p: HovorkaParameters, insulin_mU_min: jax.Array) -> jax.Array:
    """State at rest `(9, ...)` under a constant infusion `(...)` of 0 or more."""
    u = jnp.broadcast_to(jnp.asarray(insulin_mU_min, float), _people(p, insulin_mU_min))
    insulin = insulin_at_rest(p, u)
    return _state(p, *_glucose_at_rest(p, insulin[3:]), insulin)


@jax.jit
def infusion_for(p: HovorkaParameters, glucose_mg_dl: jax.Array) -> jax.Array:
    """Constant infusion `(...)` in mU/min under which plasma glucose rests at the given value, or NaN."""
    shape = _people(p, glucose_mg_dl)
    G = jnp.broadcast_to(jnp.asarray(glucose_mg_dl, float), shape) / MG_DL_PER_MMOL_L
    E, loss = p.EGP_0 * p.weight_kg, uptake_without_insulin(p, G) + renal_excretion(p, G)
    possible = (G > 0.0) & (E - loss >= -_ROUNDING * E)
    surplus = jnp.where(possible, jnp.maximum(E - loss, 0.0), 0.0)

    a = p.S_ID * (G * p.glucose_volume_l * p.S_IT + E * p.S_IE)
    b = E * p.k_12 * p.S_IE - surplus * p.S_ID
    c = surplus * p.k_12
    # a I^2 + b I - c = 0; of the two forms of its root of 0 or more, the one without cancellation
    root = jnp.sqrt(b * b + 4.0 * a * c)
    I = jnp.where(b > 0.0, 2.0 * c / (jnp.abs(b) + root), (jnp.abs(b) + root) / (2.0 * a))
    return jnp.where(possible, p.k_e * p.insulin_volume_l * I, jnp.nan)


@jax.jit
def rest_at(p: HovorkaParameters, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Constant infusion `(...)` under which plasma glucose rests at the given value, and the state `(9, ...)` there.

    Both are NaN where no infusion of 0 or more does.
    """
    u: jax.Array = infusion_for(p, glucose_mg_dl)
    insulin = insulin_at_rest(p, u)
    Q1 = jnp.asarray(glucose_mg_dl, float) / MG_DL_PER_MMOL_L * p.glucose_volume_l + 0.0 * u
    return u, _state(p, Q1, insulin[3] * Q1 / (p.k_12 + insulin[4]), insulin)


def glucose_without_insulin_mg_dl(p: HovorkaParameters) -> jax.Array:
    """Plasma glucose `(...)` at rest without insulin: the highest that an infusion can hold."""
    x: jax.Array = rest_under(p, jnp.asarray(0.0))
    return x[2] * MG_DL_PER_MMOL_L


def infusion_without_production_mU_min(p: HovorkaParameters) -> jax.Array:
    """Least constant infusion `(...)` at rest under which the liver makes no glucose, so that glucose falls to zero."""
    return jnp.asarray(p.k_e * p.insulin_volume_l / p.S_IE)
