"""Constants of Hovorka et al. (2004) for a person of 75 kg, and the variation that Boiroux et al. (2017) draw around them.

The paper lists constants and, for those that it estimates from a person's data, the means of its prior distributions;
here the means are the nominal person's. It leaves the body weight free; 75 kg is the choice of published
implementations.

Standard deviations of the variation are the square root of 6 times the standard errors that Hovorka et al. (2002) found
in six persons; the other distributions are those that Hovorka et al. (2004) give for their Bayesian estimates. Values
are drawn within one standard deviation and must be positive. One standard deviation below the mean of k_a1 lies below
zero; the minimum value of it is here a tenth of the mean.

References
----------
D. Boiroux et al., "Adaptive control in an artificial pancreas for people with type 1 diabetes", Control Eng. Pract. 58,
2017, 332-342.
R. Hovorka et al., "Partitioning glucose distribution/transport, disposal, and endogenous production during IVGTT", Am.
J. Physiol. Endocrinol. Metab. 282(5), 2002, E992-E1007.
"""

from __future__ import annotations

import math
from typing import Final

from glucoloop.patients.component import Constant
from glucoloop.patients.hovorka.equations import HovorkaParameters
from glucoloop.patients.hovorka.varying import Lognormal, Normal, Uniform

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

_PERSONS: Final = 6
_IVGTT: Final = f"{BOIROUX}, after Hovorka et al. 2002, Am. J. Physiol. Endocrinol. Metab. 282(5)"
_PRIOR: Final = f"{BOIROUX}, after Hovorka et al. 2004, Physiol. Meas. 25(4)"


def _from_error(parameter: str, mean: float, standard_error: float) -> Normal:
    return Normal(parameter, mean, standard_error * math.sqrt(_PERSONS), _IVGTT)


DISTRIBUTIONS: Final[tuple[Normal | Uniform | Lognormal, ...]] = (
    Uniform("weight_kg", 65.0, 95.0, BOIROUX),
    Uniform("A_G", 0.7, 1.2, BOIROUX),
    _from_error("EGP_0", 0.0161, 1.6e-3),
    _from_error("F_01", 0.0097, 0.9e-3),
    _from_error("k_12", 0.0649, 0.0115),
    _from_error("k_a1", 0.0055, 0.0023),
    _from_error("k_a2", 0.0683, 0.0207),
    _from_error("k_a3", 0.0304, 0.0096),
    _from_error("S_IT", 51.2e-4, 13.1e-4),
    _from_error("S_ID", 8.2e-4, 3.2e-4),
    _from_error("S_IE", 520e-4, 125e-4),
    Normal("k_e", 0.14, 0.035, _PRIOR),
    Normal("V_I", 0.12, 0.012, _PRIOR),
    Normal("absorption_rate", 0.018, 0.0045, _PRIOR),
    Lognormal("V_G", 0.15, 0.23, _PRIOR),
    Lognormal("t_maxG", math.exp(3.689), 0.25, _PRIOR),
)
