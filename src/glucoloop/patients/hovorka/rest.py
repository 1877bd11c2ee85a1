"""Steady states of the Hovorka patient.

Insulin and its effects rest in proportion to the infusion. With them the glucose which a rate holds is a closed form,
by pieces. Conversely, at a given glucose the balance is an equation in plasma insulin::

    (EGP(S_IE I) - L(G)) (k_12 + S_ID I) - Q1 S_IT S_ID I^2 = 0

where L is what leaves without insulin, ``F_01^c + F_R``. Production falls as insulin rises, so there is one root of 0
or more where production without insulin is at least that loss, and none otherwise. Each record of constants has both.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jit, jnp
from glucoloop.patients.hovorka.equations import MG_DL_PER_MMOL_L, HovorkaConstants, renal_excretion
from glucoloop.patients.resting import shape_of_people

_ROUNDING: Final = 1e-12
"""Fraction of production by which it may seem to fall short of the loss where a person rests without insulin."""


def _insulin_at_rest(p: HovorkaConstants, insulin_mU_min: jax.Array) -> jax.Array:
    """S1, S2, I, x1, x2, x3 `(6, ...)` under a constant infusion."""
    depot = insulin_mU_min * p.t_maxI
    I = insulin_mU_min / (p.k_e * p.insulin_volume_l)
    return jnp.stack(jnp.broadcast_arrays(depot, depot, I, p.S_IT * I, p.S_ID * I, p.S_IE * I))


def _state(p: HovorkaConstants, Q1: jax.Array, insulin: jax.Array) -> jax.Array:
    """Steady state, with Q1 and insulin at steady state."""
    Q2 = insulin[3] * Q1 / (p.k_12 + insulin[4])
    return jnp.concatenate([jnp.stack([Q1, Q2, Q1 / p.glucose_volume_l]), insulin])


@jit()
def rest_under(p: HovorkaConstants, insulin_mU_min: jax.Array) -> jax.Array:
    """Steady state `(9, ...)` under a constant infusion `(...)` of 0 or more."""
    u = jnp.broadcast_to(jnp.asarray(insulin_mU_min, float), shape_of_people(p, insulin_mU_min))
    insulin = _insulin_at_rest(p, u)
    x1, x2, x3 = insulin[3:]
    return _state(p, p.glucose_at_rest(p.hepatic_production(x3), x1 * x2 / (p.k_12 + x2)), insulin)


@jit()
def infusion_for(p: HovorkaConstants, glucose_mg_dl: jax.Array) -> jax.Array:
    """Constant infusion `(...)` in mU/min under which plasma glucose rests at the given value, or NaN."""
    shape = shape_of_people(p, glucose_mg_dl)
    G = jnp.broadcast_to(jnp.asarray(glucose_mg_dl, float), shape) / MG_DL_PER_MMOL_L
    E, loss = p.production_without_insulin, p.uptake_without_insulin(G) + renal_excretion(p, G)
    possible = (G > 0.0) & (E - loss >= -_ROUNDING * E)
    I = p.insulin_at_rest(jnp.where(possible, G, 1.0) * p.glucose_volume_l, jnp.where(possible, loss, E))
    return jnp.where(possible, p.k_e * p.insulin_volume_l * I, jnp.nan)


@jit()
def rest_at(p: HovorkaConstants, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Constant infusion `(...)` under which plasma glucose rests at the given value, and the state `(9, ...)` there.

    Both are NaN where no infusion of 0 or more does.
    """
    u: jax.Array = infusion_for(p, glucose_mg_dl)
    Q1 = jnp.asarray(glucose_mg_dl, float) / MG_DL_PER_MMOL_L * p.glucose_volume_l + 0.0 * u
    return u, _state(p, Q1, _insulin_at_rest(p, u))


def glucose_without_insulin_mg_dl(p: HovorkaConstants) -> jax.Array:
    """Plasma glucose `(...)` at steady state without insulin: the highest that an infusion can hold."""
    x: jax.Array = rest_under(p, jnp.asarray(0.0))
    return x[2] * MG_DL_PER_MMOL_L
