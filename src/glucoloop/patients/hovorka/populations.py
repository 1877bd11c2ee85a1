"""Populations around the patients of Hovorka et al. (2004) and Wilinska et al. (2010)."""

from __future__ import annotations

import math
from collections.abc import Iterable

from glucoloop.parts.patients import PATIENTS
from glucoloop.patients.hovorka.parameters import boiroux2017, wilinska2010
from glucoloop.patients.hovorka.parameters.distributions import LEAST_OF_MEAN, Lognormal, Normal, Uniform
from glucoloop.patients.population import Population
from glucoloop.patients.variation import TRUNCATION_SD, Variation


def _variation(of: Normal | Uniform | Lognormal, within_sd: float) -> Variation:
    if isinstance(of, Uniform):
        half = (of.most - of.least) / 2.0
        return Variation(parameter=of.parameter, distribution="uniform", centre=of.least + half, spread=half)
    if isinstance(of, Normal):
        reach = within_sd * of.sd
        return Variation(
            parameter=of.parameter,
            distribution="normal",
            centre=of.mean,
            spread=of.sd,
            lower=of.mean - reach if reach < of.mean else LEAST_OF_MEAN * of.mean,
            upper=of.mean + reach,
        )
    return Variation(
        parameter=of.parameter,
        distribution="lognormal",
        centre=of.median,
        spread_pct=100.0 * math.sqrt(math.expm1(of.sd_of_logarithm**2)),
        lower=of.median * math.exp(-within_sd * of.sd_of_logarithm),
        upper=of.median * math.exp(within_sd * of.sd_of_logarithm),
    )


def _population(
    name: str, patient: str, distributions: Iterable[Normal | Uniform | Lognormal], within_sd: float
) -> dict[str, Population]:
    variations = tuple(_variation(of, within_sd) for of in distributions)
    return {name: Population(name, variations, PATIENTS[patient].populations[name], patient=patient)}


def of_hovorka_2004() -> dict[str, Population]:
    """Populations around the patient of 2004 by name."""
    return _population("boiroux2017", "hovorka-2004", boiroux2017.DISTRIBUTIONS, 1.0)


def of_wilinska_2010() -> dict[str, Population]:
    """Populations around the patient of 2010 by name."""
    return _population("wilinska2010", "wilinska-2010", wilinska2010.DISTRIBUTIONS, TRUNCATION_SD)
