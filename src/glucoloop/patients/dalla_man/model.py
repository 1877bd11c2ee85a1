"""The average person of Dalla Man et al. (2007) as a model: an operating point, and a population around it.

The spreads of the population are our own: no distribution of these constants is published.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.patients.dalla_man.equations import STATE_NAMES
from glucoloop.patients.dalla_man.parameters.dallaman2007 import CONSTANTS
from glucoloop.patients.dalla_man.patient import DallaManPatient
from glucoloop.patients.dalla_man.simglucose import NAME as SIMGLUCOSE
from glucoloop.patients.dalla_man.simglucose import people_of_simglucose
from glucoloop.patients.model import PatientModel
from glucoloop.patients.population import Population
from glucoloop.patients.settings import PATIENTS
from glucoloop.patients.variation import Distribution, Variation
from glucoloop.refusal import Refusal

NAME: Final = "uva-padova-2008"
VARIED: Final = ("V_mx", "k_p3", "m_1", "m_4", "p_2U", "k_d", "k_a2", "k_max", "k_min", "k_abs")
SPREAD_CV_PCT: Final = 20.0
WEIGHT_CV_PCT: Final = 15.0
_SHARES: Final = ("b", "d", "HE_b")
_ROUNDING: Final = 1e-9
_EFFECT: Final = STATE_NAMES.index("X")


def _populations() -> dict[str, Any]:
    """Populations around the average person by name."""
    lognormal = [Variation(parameter=name, distribution="lognormal", spread_pct=SPREAD_CV_PCT) for name in VARIED]
    weight = Variation(parameter="weight_kg", distribution="lognormal", spread_pct=WEIGHT_CV_PCT)
    summaries = PATIENTS[NAME].populations
    return {"lognormal": Population("lognormal", (*lognormal, weight), summaries["lognormal"], patient=NAME)}


def _refuse_impossible(varied: Mapping[str, Distribution]) -> None:
    """Refuse distributions that can make an impossible person.

    Every constant must stay above 0, what is a share below 1, and the stomach must not empty faster at its minimum.
    """
    for name, distribution in varied.items():
        if not distribution.lower > 0.0 or (name in _SHARES and not distribution.upper < 1.0):
            bound = "between 0 and 1" if name in _SHARES else "above 0"
            raise Refusal(
                f"{name} can vary from {distribution.lower:g} to {distribution.upper:g} but must stay {bound}; "
                "narrow its spread, or give lower and upper"
            )


def _sound(x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Whether insulin and glucose of states ``(10, ...)`` are physically possible: no amount is below zero.

    The effect X may be, which is counted from basal insulin.
    """
    del lowest_mg_dl
    possible = x >= -_ROUNDING
    insulin = jnp.all(possible[3:_EFFECT], axis=0) & jnp.all(possible[_EFFECT + 1 :], axis=0)
    return insulin, jnp.all(possible[:3], axis=0)


UVA_PADOVA_2008_MODEL: Final[PatientModel] = dataclasses.replace(
    DallaManPatient.model({"fasting-120": 120.0}, _populations),
    read_populations={SIMGLUCOSE: functools.partial(people_of_simglucose, NAME)},
    refuse=_refuse_impossible,
    meanings={constant.name: constant.meaning.partition(",")[0] for constant in CONSTANTS},
    sound=_sound,
)
