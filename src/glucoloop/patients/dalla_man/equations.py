"""Balances of glucose and insulin of the simulator of 2008 (UVA/Padova), after Dalla Man et al. (2007).

With glucose in plasma and slow tissues G_p, G_t and in the interstitium G_s [mg/kg], insulin in plasma and liver
I_p, I_l and under the skin I_sc1, I_sc2 [pmol/kg], insulin I = I_p / V_I [pmol/l] and its effects X, I_1, I_d, in a
body of the weight BW [kg]:

    G_p'   = EGP + Ra / BW - U_ii - E - k_1 G_p + k_2 G_t       EGP = max(k_p1 - k_p2 G_p - k_p3 I_d, 0)
    G_t'   = -U_id + k_1 G_p - k_2 G_t                          U_id = (V_m0 + V_mx X) G_t / (K_m0 + G_t)
    G_s'   = k_sc (G_p - G_s)                                   E = k_e1 max(G_p - k_e2, 0)
    I_p'   = -(m_2 + m_4) I_p + m_1 I_l + k_a1 I_sc1 + k_a2 I_sc2
    I_l'   = -(m_1 + m_30) I_l + m_2 I_p                        m_30 = HE_b m_1 / (1 - HE_b)
    I_sc1' = u / BW - (k_a1 + k_d) I_sc1,    I_sc2' = k_d I_sc1 - k_a2 I_sc2
    X'     = p_2U (I - I_b - X),    I_1' = k_i (I - I_1),    I_d' = k_i (I_1 - I_d)

The uptake U_ii = F_cns by the brain does not depend on glucose, and would draw G_p below zero under an overdose. The
simulator stops a state for good once it is below zero, which also makes every such state one of rest. Here U_ii falls
in proportion to glucose below 5 mg/dl instead: no state ever goes below zero, glucose recovers, and above 5 mg/dl
nothing differs.

References
----------
C. Dalla Man, R. A. Rizza, C. Cobelli, "Meal simulation model of the glucose-insulin system", IEEE Trans. Biomed. Eng.
54(10), 2007, 1740-1749.
C. Dalla Man, D. M. Raimondo, R. A. Rizza, C. Cobelli, "GIM, simulation software of meal glucose-insulin model", J.
Diabetes Sci. Technol. 1(3), 2007, 323-330.
B. P. Kovatchev, M. Breton, C. Dalla Man, C. Cobelli, "In silico preclinical trials: a proof of concept in closed-loop
control of type 1 diabetes", J. Diabetes Sci. Technol. 3(1), 2009, 44-55.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop.units import MU_MIN_PER_PMOL_MIN

STATE_NAMES: Final = ("G_p", "G_t", "G_s", "I_p", "I_l", "I_sc1", "I_sc2", "X", "I_1", "I_d")
UPTAKE_FALLS_BELOW_MG_DL: Final = 5.0
"""Glucose below which the uptake by the brain falls, so that glucose stays above zero."""


def balances(c: Mapping[str, Any], x: jax.Array, insulin_mU_min: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
    """Rate of change of the state ``(10, ...)`` per minute, in the order of `STATE_NAMES`."""
    G_p, G_t, G_s, I_p, I_l, I_sc1, I_sc2, X, I_1, I_d = x
    # what is divided by is a person's own, so that a reciprocal is found once
    per_kg, uptake_falls_below = 1.0 / c["weight_kg"], UPTAKE_FALLS_BELOW_MG_DL * c["V_G"]
    u = insulin_mU_min / MU_MIN_PER_PMOL_MIN * per_kg
    insulin = I_p * (1.0 / c["V_I"])
    EGP = jnp.maximum(c["k_p1"] - c["k_p2"] * G_p - c["k_p3"] * I_d, 0.0)
    U_ii = c["F_cns"] * jnp.minimum(G_p * (1.0 / uptake_falls_below), 1.0)
    E = c["k_e1"] * jnp.maximum(G_p - c["k_e2"], 0.0)
    U_id = (c["V_m0"] + c["V_mx"] * X) * G_t / (c["K_m0"] + G_t)
    to_tissues = c["k_1"] * G_p - c["k_2"] * G_t
    dissociates = c["k_d"] * I_sc1
    extracted = c["HE_b"] / (1.0 - c["HE_b"]) * c["m_1"]
    return jnp.stack(
        [
            EGP + meal_mg_min * per_kg - U_ii - E - to_tissues,
            to_tissues - U_id,
            c["k_sc"] * (G_p - G_s),
            c["m_1"] * I_l - (c["m_2"] + c["m_4"]) * I_p + c["k_a1"] * I_sc1 + c["k_a2"] * I_sc2,
            c["m_2"] * I_p - (c["m_1"] + extracted) * I_l,
            u - c["k_a1"] * I_sc1 - dissociates,
            dissociates - c["k_a2"] * I_sc2,
            c["p_2U"] * (insulin - c["I_b"] - X),
            c["k_i"] * (insulin - I_1),
            c["k_i"] * (I_1 - I_d),
        ]
    )
