"""Populations around the patient of Hovorka et al. (2004)."""

from __future__ import annotations

import math
from typing import Final

from glucoloop.patients.hovorka.parameters.boiroux2017 import DISTRIBUTIONS, LEAST_OF_MEAN, Lognormal, Normal, Uniform
from glucoloop.patients.population import Population
from glucoloop.patients.variation import Variation
from glucoloop.registry.patients import PATIENTS

_NAME: Final = "hovorka-2004"
_SUMMARIES: Final = PATIENTS[_NAME].populations


def _variation(of: Normal | Uniform | Lognormal) -> Variation:
    if isinstance(of, Uniform):
        half = (of.most - of.least) / 2.0
        return Variation(parameter=of.parameter, distribution="uniform", centre=of.least + half, spread=half)
    if isinstance(of, Normal):
        return Variation(
            parameter=of.parameter,
            distribution="normal",
            centre=of.mean,
            spread=of.sd,
            lower=of.mean - of.sd if of.sd < of.mean else LEAST_OF_MEAN * of.mean,
            upper=of.mean + of.sd,
        )
    return Variation(
        parameter=of.parameter,
        distribution="lognormal",
        centre=of.median,
        spread_pct=100.0 * math.sqrt(math.expm1(of.sd_of_logarithm**2)),
        lower=of.median * math.exp(-of.sd_of_logarithm),
        upper=of.median * math.exp(of.sd_of_logarithm),
    )


POPULATIONS: Final[dict[str, Population]] = {
    "boiroux2017": Population(
        "boiroux2017", tuple(map(_variation, DISTRIBUTIONS)), _SUMMARIES["boiroux2017"], patient=_NAME
    )
}
