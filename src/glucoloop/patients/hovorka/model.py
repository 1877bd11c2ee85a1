"""Patients of Hovorka et al. (2004) and Wilinska et al. (2010) as models: operating points and populations."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.patients.hovorka.equations import GLUCOSE, INSULIN, MG_DL_PER_MMOL_L, STATE_NAMES, HovorkaConstants
from glucoloop.patients.hovorka.parameters import boiroux2017, hovorka2004, wilinska2010
from glucoloop.patients.hovorka.parameters.hovorka2004 import HOVORKA_2004
from glucoloop.patients.hovorka.parameters.wilinska2010 import WILINSKA_2010
from glucoloop.patients.hovorka.patient import HovorkaPatient, at_setpoint
from glucoloop.patients.hovorka.varying import (
    MIN_OF_MEAN,
    Lognormal,
    Normal,
    Uniform,
    meanings,
    nominal_values,
    refuse_impossible,
    with_values,
)
from glucoloop.patients.model import PatientModel, Values
from glucoloop.patients.population import Population
from glucoloop.patients.provenance import Constant
from glucoloop.patients.settings import PATIENTS
from glucoloop.patients.variation import TRUNCATION_SD, Variation


def _variation(distribution: Normal | Uniform | Lognormal, within_sd: float) -> Variation:
    if isinstance(distribution, Uniform):
        half = (distribution.most - distribution.least) / 2.0
        return Variation(
            parameter=distribution.parameter, distribution="uniform", centre=distribution.least + half, spread=half
        )
    if isinstance(distribution, Normal):
        reach = within_sd * distribution.sd
        return Variation(
            parameter=distribution.parameter,
            distribution="normal",
            centre=distribution.mean,
            spread=distribution.sd,
            lower=distribution.mean - reach if reach < distribution.mean else MIN_OF_MEAN * distribution.mean,
            upper=distribution.mean + reach,
        )
    return Variation(
        parameter=distribution.parameter,
        distribution="lognormal",
        centre=distribution.median,
        spread_pct=100.0 * math.sqrt(math.expm1(distribution.sd_of_logarithm**2)),
        lower=distribution.median * math.exp(-within_sd * distribution.sd_of_logarithm),
        upper=distribution.median * math.exp(within_sd * distribution.sd_of_logarithm),
    )


def _population(
    name: str, patient: str, distributions: Iterable[Normal | Uniform | Lognormal], within_sd: float
) -> dict[str, Population]:
    variations = tuple(_variation(distribution, within_sd) for distribution in distributions)
    return {name: Population(name, variations, PATIENTS[patient].populations[name], patient=patient)}


def _of_hovorka_2004() -> dict[str, Population]:
    """Populations around the patient of 2004 by name."""
    return _population("boiroux2017", "hovorka-2004", boiroux2017.DISTRIBUTIONS, 1.0)


def _of_wilinska_2010() -> dict[str, Population]:
    """Populations around the patient of 2010 by name."""
    return _population("wilinska2010", "wilinska-2010", wilinska2010.DISTRIBUTIONS, TRUNCATION_SD)


_ROUNDING: Final = 1e-9
_INTEGRATION_MG_DL: Final = 0.1
"""Integration error with two exponential steps per sample."""
_INTERSTITIAL: Final = STATE_NAMES.index("IG")


def sound(x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Whether insulin and glucose of states ``(9, ...)`` are physically possible, ``(...)`` each.

    No depot, amount, concentration or effect is ever below zero. Interstitial glucose follows plasma glucose, so that
    it has never been below the lowest of that.
    """
    insulin = jnp.all(x[INSULIN] >= -_ROUNDING, axis=0)
    follows = x[_INTERSTITIAL] * MG_DL_PER_MMOL_L >= lowest_mg_dl - _INTEGRATION_MG_DL
    return insulin, jnp.all(x[GLUCOSE] >= -_ROUNDING, axis=0) & follows


def _model(
    person: HovorkaConstants, constants: Iterable[Constant], populations: Callable[[], Mapping[str, Any]]
) -> PatientModel:
    """Model around a nominal person, who rests at 120 mg/dl."""

    def build(values: Values, basal_insulin_mU_min: Any, setpoint_mg_dl: Any) -> HovorkaPatient:
        return HovorkaPatient(
            parameters=jax.tree.map(jnp.asarray, with_values(person, values)),
            basal_insulin_mU_min=jnp.asarray(basal_insulin_mU_min),
            setpoint_mg_dl=jnp.asarray(setpoint_mg_dl),
        )

    return PatientModel(
        build=build,
        operating_points={"fasting-120": lambda: at_setpoint(person, 120.0)},
        nominal=nominal_values(person),
        populations=populations,
        meanings=meanings(constants),
        refuse=functools.partial(refuse_impossible, person),
        sound=sound,
    )


HOVORKA_2004_MODEL: Final = _model(HOVORKA_2004, hovorka2004.CONSTANTS, _of_hovorka_2004)
WILINSKA_2010_MODEL: Final = _model(WILINSKA_2010, wilinska2010.CONSTANTS, _of_wilinska_2010)
