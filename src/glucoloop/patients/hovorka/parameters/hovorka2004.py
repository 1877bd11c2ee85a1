"""Constants of Hovorka et al. (2004), for a person of 75 kg.

The paper lists constants and, for those that it estimates from a person's data, the means of its prior distributions;
here the means are the nominal person's. It leaves the body weight free; 75 kg is the choice of published
implementations.
"""

from __future__ import annotations

from typing import Final

from glucoloop.patients.hovorka.equations import HovorkaParameters
from glucoloop.patients.provenance import Constant

HOVORKA: Final = "Hovorka et al. 2004, Physiol. Meas. 25(4)"
BOIROUX: Final = "Boiroux et al. 2017, Control Eng. Pract. 58"

# fmt: off
# ruff: noqa: E501 (a table reads best with one value on each line)
CONSTANTS: Final = (
    Constant("weight_kg", 75.0, "kg", "body weight; left free by the paper, the choice of published implementations", f"implementations of {HOVORKA}"),
    Constant("t_maxI", 55.0, "min", "time to the maximum of insulin absorption", HOVORKA),
    Constant("k_e", 0.138, "1/min", "elimination of insulin from plasma", HOVORKA),
    Constant("V_I", 0.12, "l/kg", "volume of insulin", HOVORKA),
    Constant("k_a1", 0.006, "1/min", "rate at which the effect of insulin on transport follows insulin", HOVORKA),
    Constant("k_a2", 0.06, "1/min", "rate at which the effect of insulin on disposal follows insulin", HOVORKA),
    Constant("k_a3", 0.03, "1/min", "rate at which the effect of insulin on production follows insulin", HOVORKA),
    Constant("S_IT", 51.2e-4, "1/min per mU/l", "sensitivity of glucose transport to insulin", HOVORKA),
    Constant("S_ID", 8.2e-4, "1/min per mU/l", "sensitivity of glucose disposal to insulin", HOVORKA),
    Constant("S_IE", 520e-4, "l/mU", "sensitivity of glucose production to insulin", HOVORKA),
    Constant("V_G", 0.16, "l/kg", "volume of the accessible glucose compartment", HOVORKA),
    Constant("k_12", 0.066, "1/min", "transfer of glucose from the non-accessible to the accessible compartment", HOVORKA),
    Constant("EGP_0", 0.0161, "mmol/kg/min", "production of glucose by the liver, extrapolated to no insulin", HOVORKA),
    Constant("F_01", 0.0097, "mmol/kg/min", "uptake of glucose that does not depend on insulin", HOVORKA),
    Constant("uptake_threshold", 4.5, "mmol/l", "glucose below which this uptake falls in proportion", HOVORKA),
    Constant("renal_threshold", 9.0, "mmol/l", "glucose above which the kidney excretes glucose", HOVORKA),
    Constant("renal_clearance", 0.003, "1/min", "excreted fraction of what exceeds the renal threshold", HOVORKA),
    Constant("t_IG", 15.0, "min", "delay of interstitial glucose behind plasma glucose", BOIROUX),
    Constant("A_G", 0.8, "1", "fraction of eaten carbohydrate that appears as glucose", HOVORKA),
    Constant("t_maxG", 40.0, "min", "time to the maximum of the appearance of glucose after a meal", HOVORKA),
)
# fmt: on

HOVORKA_2004: Final = HovorkaParameters(**{constant.name: constant.value for constant in CONSTANTS})
