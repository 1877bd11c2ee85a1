"""The healthy basal state by which the effects of the model are normalised, for another fasting glucose.

Sorensen (1985) finds the basal state of a healthy person organ by organ. At rest after a night's fast every effect is
1, so that every rate has its basal value, and each glucose balance gives one concentration from those upstream:

    G_BV = G_H - r_BGU / q_B          brain
    G_G  = G_H - r_GGU / q_G          gut
    G_K  = G_H                        kidney, which excretes nothing
    G_PV = G_H - r_PGU / q_P          periphery, vascular
    G_PI = G_PV - T_P r_PGU / v_PI    periphery, interstitial
    G_L  = G_H + (r_BGU + r_RBCU + r_PGU) / q_L    liver, from the balance of heart and lungs

The balance of the liver is then satisfied, because basal production less basal uptake by the liver, 155 - 20 mg/min, is
what the other organs take up, 70 + 10 + 20 + 35 mg/min. So arterial glucose is the only free concentration, and all
others move with it by the same amount. No split of the shift between organs is left open.
"""

from __future__ import annotations

import dataclasses

import jax

from glucoloop.patients.sorensen.equations import SorensenParameters
from glucoloop.refusal import Refusal


def basal_glucose(p: SorensenParameters, arterial_mg_dl: jax.Array | float) -> tuple[jax.Array | float, ...]:
    """Healthy basal `G_H`, `G_L` and `G_PI` in mg/dl from the balances, for a fasting arterial glucose."""
    liver = arterial_mg_dl + (p.brain_uptake + p.red_cell_uptake + p.basal_peripheral_uptake) / p.q_L
    vascular = arterial_mg_dl - p.basal_peripheral_uptake / p.q_P
    return arterial_mg_dl, liver, vascular - p.basal_peripheral_uptake * p.T_P / p.v_PI


def with_fasting_glucose(p: SorensenParameters, arterial_mg_dl: float) -> SorensenParameters:
    """Constants of a person whose healthy basal state has another fasting arterial glucose.

    The three references of the glucose effects move by as much as fasting glucose does, which is what the balances ask
    for (see above). The printed references are kept as the starting point: they differ from the balances by rounding,
    and in the periphery by .17 mg/dl.
    """
    lower = p.ref_G_H - arterial_mg_dl
    shifted = {name: getattr(p, name) - lower for name in ("ref_G_H", "ref_G_L", "ref_G_PI")}
    if not min(shifted.values()) > 0.0:
        raise Refusal(
            f"a fasting arterial glucose of {arterial_mg_dl:g} mg/dl leaves the peripheral tissue none; "
            f"give more than {p.ref_G_H - p.ref_G_PI:.3g} mg/dl"
        )
    return dataclasses.replace(p, **shifted)
