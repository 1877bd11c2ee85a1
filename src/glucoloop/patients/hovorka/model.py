"""Patients of Hovorka et al. (2004) and Wilinska et al. (2010) as models: operating points and populations."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.patients.hovorka.equations import GLUCOSE, INSULIN, MG_DL_PER_MMOL_L, STATE_NAMES, HovorkaConstants
from glucoloop.patients.hovorka.parameters import hovorka2004, wilinska2010
from glucoloop.patients.hovorka.parameters.hovorka2004 import HOVORKA_2004
from glucoloop.patients.hovorka.parameters.wilinska2010 import WILINSKA_2010
from glucoloop.patients.hovorka.patient import HovorkaPatient, at_setpoint
from glucoloop.patients.hovorka.varying import meanings, nominal_values, refuse_impossible, with_values
from glucoloop.patients.model import PatientModel, Values
from glucoloop.patients.provenance import Constant

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


def _populations_2004() -> Mapping[str, Any]:
    from glucoloop.patients.hovorka.populations import of_hovorka_2004

    return of_hovorka_2004()


def _populations_2010() -> Mapping[str, Any]:
    from glucoloop.patients.hovorka.populations import of_wilinska_2010

    return of_wilinska_2010()


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


HOVORKA_2004_MODEL: Final = _model(HOVORKA_2004, hovorka2004.CONSTANTS, _populations_2004)
WILINSKA_2010_MODEL: Final = _model(WILINSKA_2010, wilinska2010.CONSTANTS, _populations_2010)
