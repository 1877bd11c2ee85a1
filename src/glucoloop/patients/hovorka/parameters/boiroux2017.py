"""Variation between people, as Boiroux et al. (2017) draw it around the model of Hovorka et al. (2004).

Standard deviations are the square root of 6 times the standard errors that Hovorka et al. (2002) found in six persons;
the other distributions are those that Hovorka et al. (2004) give for their Bayesian estimates. Values are drawn within
one standard deviation and must be positive. One standard deviation below the mean of k_a1 lies below zero; the minimum
value of it is here a tenth of the mean.

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

from glucoloop.patients.hovorka.varying import Lognormal, Normal, Uniform

PERSONS: Final = 6
SOURCE: Final = "Boiroux et al. 2017, Control Eng. Pract. 58"
IVGTT: Final = f"{SOURCE}, after Hovorka et al. 2002, Am. J. Physiol. Endocrinol. Metab. 282(5)"
PRIOR: Final = f"{SOURCE}, after Hovorka et al. 2004, Physiol. Meas. 25(4)"


def _from_error(parameter: str, mean: float, standard_error: float) -> Normal:
    return Normal(parameter, mean, standard_error * math.sqrt(PERSONS), IVGTT)


DISTRIBUTIONS: Final[tuple[Normal | Uniform | Lognormal, ...]] = (
    Uniform("weight_kg", 65.0, 95.0, SOURCE),
    Uniform("A_G", 0.7, 1.2, SOURCE),
    _from_error("EGP_0", 0.0161, 1.6e-3),
    _from_error("F_01", 0.0097, 0.9e-3),
    _from_error("k_12", 0.0649, 0.0115),
    _from_error("k_a1", 0.0055, 0.0023),
    _from_error("k_a2", 0.0683, 0.0207),
    _from_error("k_a3", 0.0304, 0.0096),
    _from_error("S_IT", 51.2e-4, 13.1e-4),
    _from_error("S_ID", 8.2e-4, 3.2e-4),
    _from_error("S_IE", 520e-4, 125e-4),
    Normal("k_e", 0.14, 0.035, PRIOR),
    Normal("V_I", 0.12, 0.012, PRIOR),
    Normal("absorption_rate", 0.018, 0.0045, PRIOR),
    Lognormal("V_G", 0.15, 0.23, PRIOR),
    Lognormal("t_maxG", math.exp(3.689), 0.25, PRIOR),
)
