"""Populations around the patient of Parker, Doyle and Peppas (1999)."""

from __future__ import annotations

from typing import Final

from glucoloop.parts.patients import PATIENTS
from glucoloop.patients.population import Population
from glucoloop.patients.sorensen.parameters.parker2000 import LARGEST_VARIATION_PCT, UNCERTAIN
from glucoloop.patients.sorensen.varying import ADULTS
from glucoloop.patients.variation import Variation

_NAME: Final = "parker-1999"
_SUMMARIES: Final = PATIENTS[_NAME].populations
_SPREAD_CV_PCT: Final = 20.0

POPULATIONS: Final[dict[str, Population]] = {
    population.name: population
    for population in (
        Population(
            "parker2000",
            tuple(
                Variation(parameter=of.parameter, distribution="uniform", spread_pct=LARGEST_VARIATION_PCT)
                if of.half_width is None
                else Variation(parameter=of.parameter, distribution="uniform", spread=of.half_width)
                for of in UNCERTAIN
            ),
            _SUMMARIES["parker2000"],
            patient=_NAME,
        ),
        Population(
            "lognormal",
            (
                *(
                    Variation(
                        parameter=of.parameter,
                        distribution="lognormal",
                        spread_pct=_SPREAD_CV_PCT,
                        # insulin of the periphery could not be cleared beyond 0.243
                        upper=0.21 if of.parameter == "F_PC" else None,
                    )
                    if of.half_width is None
                    else Variation(parameter=of.parameter, distribution="normal", spread=_SPREAD_CV_PCT / 100.0)
                    for of in UNCERTAIN
                ),
                ADULTS,
            ),
            _SUMMARIES["lognormal"],
            patient=_NAME,
        ),
    )
}
