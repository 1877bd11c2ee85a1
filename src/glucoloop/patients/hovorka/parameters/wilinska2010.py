"""Constants and priors of Wilinska et al. (2010), the Cambridge simulator, for a person of 74.9 kg.

They are those of the paper's Tables 1 and 2 as two implementations restate them: the artificial pancreas simulator of
the McGill Diabetes Lab, which also gives the volume of glucose and the bioavailability, and tir-tuner, which also gives
the distributions. tir-tuner takes 0.15 l/kg, the median of the distribution of that volume, and a bioavailability of 1.

Not known from them, and so not here: the distributions of the three sensitivities to insulin, of k_12, k_a1 to k_a3,
EGP_0 and F_01; the way in which a ceiling on the appearance of glucose from the gut, of 0.02 to 0.035 mmol/kg/min, acts
on what a meal holds; and the oscillations of constants within a person.

References
----------
M. E. Wilinska et al., "Simulation environment to evaluate closed-loop insulin delivery systems in type 1 diabetes",
J. Diabetes Sci. Technol. 4(1), 2010, 132-144.
"""

from __future__ import annotations

import math
from typing import Final

from glucoloop.patients.hovorka.varying import Lognormal, Normal, Uniform
from glucoloop.patients.hovorka.wilinska import WilinskaParameters
from glucoloop.patients.provenance import Constant

WILINSKA: Final = "Wilinska et al. 2010, J. Diabetes Sci. Technol. 4(1)"
MCGILL: Final = f"{WILINSKA}, as the simulator of the McGill Diabetes Lab has it"

# fmt: off
# ruff: noqa: E501 (a table reads best with one value on each line)
CONSTANTS: Final = (
    Constant("weight_kg", 74.9, "kg", "body weight, mean", WILINSKA),
    Constant("t_maxI", 1.0 / 0.018, "min", "time to the maximum of insulin absorption, of the absorption rate 0.018 1/min", WILINSKA),
    Constant("k_e", 0.14, "1/min", "elimination of insulin from plasma", WILINSKA),
    Constant("V_I", 0.12, "l/kg", "volume of insulin", WILINSKA),
    Constant("k_a1", 0.0034, "1/min", "rate at which the effect of insulin on transport follows insulin", WILINSKA),
    Constant("k_a2", 0.056, "1/min", "rate at which the effect of insulin on disposal follows insulin", WILINSKA),
    Constant("k_a3", 0.024, "1/min", "rate at which the effect of insulin on production follows insulin", WILINSKA),
    Constant("S_IT", 18.41e-4, "1/min per mU/l", "sensitivity of glucose transport to insulin", WILINSKA),
    Constant("S_ID", 5.05e-4, "1/min per mU/l", "sensitivity of glucose disposal to insulin", WILINSKA),
    Constant("S_IE", 190e-4, "l/mU", "sensitivity of glucose production to insulin", WILINSKA),
    Constant("V_G", 0.16, "l/kg", "volume of the accessible glucose compartment", MCGILL),
    Constant("k_12", 0.060, "1/min", "transfer of glucose from the non-accessible to the accessible compartment", WILINSKA),
    Constant("EGP_0", 0.0169, "mmol/kg/min", "production of glucose by the liver, extrapolated to no insulin", WILINSKA),
    Constant("F_01", 0.0111, "mmol/kg/min", "uptake of glucose that does not depend on insulin", WILINSKA),
    Constant("uptake_half", 1.0, "mmol/l", "glucose at which this uptake is half of its maximum", WILINSKA),
    Constant("uptake_share", 0.85, "1", "share that F_01 is of the maximum uptake", WILINSKA),
    Constant("renal_threshold", 9.0, "mmol/l", "glucose above which the kidney excretes glucose", WILINSKA),
    Constant("renal_clearance", 0.01, "1/min", "excreted fraction of what exceeds the renal threshold", WILINSKA),
    Constant("t_IG", math.exp(2.372), "min", "delay of interstitial glucose behind plasma glucose", WILINSKA),
    Constant("A_G", 0.8, "1", "fraction of eaten carbohydrate that appears as glucose", MCGILL),
    Constant("t_maxG", 40.0, "min", "time to the maximum of the appearance of glucose after a meal", WILINSKA),
)
# fmt: on

WILINSKA_2010: Final = WilinskaParameters(**{constant.name: constant.value for constant in CONSTANTS})

DISTRIBUTIONS: Final[tuple[Normal | Uniform | Lognormal, ...]] = (
    Normal("weight_kg", 74.9, 14.4, WILINSKA),
    Lognormal("V_G", math.exp(-1.897), 0.23, WILINSKA),
    Normal("V_I", 0.12, 0.012, WILINSKA),
    Normal("k_e", 0.14, 0.035, WILINSKA),
    Normal("absorption_rate", 0.018, 0.0045, WILINSKA),
    Normal("renal_threshold", 9.0, 1.5, WILINSKA),
    Normal("renal_clearance", 0.01, 0.025, WILINSKA),
    Uniform("A_G", 0.7, 1.2, WILINSKA),
    Lognormal("t_maxG", math.exp(3.689), 0.25, WILINSKA),
    Lognormal("t_IG", math.exp(2.372), 1.09, WILINSKA),
)
"""Distributions that are known; each constant is drawn independently."""
