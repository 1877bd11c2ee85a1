"""Scaling with body weight: volumes and flows in proportion, rates of metabolism unchanged.

A person of another weight has more or less blood and tissue and proportionally more or less flow, so the times in which
blood goes round stay the same. Insulin leaves in proportion to flow: the same infusion per kilogram gives the same
insulin concentrations, exactly. Rates of metabolism (production and uptake of glucose, its excretion) are not scaled,
so glucose differs a little less from organ to organ in a heavier person, and the basal rate is nearly in proportion to
weight: per kilogram it is 1.5 % below that at 70 kg for 50 kg, and 1.1 % above it for 100 kg.

References
----------
J. T. Sorensen, "A physiologic model of glucose metabolism in man and its use to design and assess improved insulin
therapies for diabetes", Sc.D. thesis, MIT, 1985: a man of 70 kg.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import jax

from glucoloop.patients.sorensen.equations import SorensenParameters

REFERENCE_WEIGHT_KG: Final = 70.0
"""Weight of the man whose volumes and flows are printed."""

VOLUMES: Final = (
    *("v_BV", "v_BI", "v_H", "v_G", "v_L", "v_K", "v_PV", "v_PI"),
    *("V_B", "V_H", "V_G", "V_L", "V_K", "V_PV", "V_PI"),
)
FLOWS: Final = (
    *("q_B", "q_A", "q_G", "q_L", "q_K", "q_P"),
    *("Q_B", "Q_A", "Q_G", "Q_L", "Q_K", "Q_P"),
)


def scaled_to_weight(p: SorensenParameters, weight_kg: jax.Array | float) -> SorensenParameters:
    """Constants with every volume and flow times ``weight_kg / 70``, from those at 70 kg."""
    factor = weight_kg / REFERENCE_WEIGHT_KG
    return dataclasses.replace(p, **{name: getattr(p, name) * factor for name in (*VOLUMES, *FLOWS)})
