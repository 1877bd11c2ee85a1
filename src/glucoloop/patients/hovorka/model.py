"""Patient of Hovorka et al. (2004) as a model: operating points, populations, and variable constants."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.patients.hovorka.equations import GLUCOSE, INSULIN, MG_DL_PER_MMOL_L, STATE_NAMES
from glucoloop.patients.hovorka.parameters.hovorka2004 import HOVORKA_2004
from glucoloop.patients.hovorka.patient import HovorkaPatient, at_setpoint
from glucoloop.patients.hovorka.varying import MEANINGS, NOMINAL, refuse_impossible, with_values
from glucoloop.patients.model import PatientModel, Values

_ROUNDING: Final = 1e-9
_INTEGRATION_MG_DL: Final = 0.1
"""Integration error with two exponential steps per sample."""
_INTERSTITIAL: Final = STATE_NAMES.index("IG")


def _build(values: Values, basal_insulin_mU_min: Any, setpoint_mg_dl: Any) -> HovorkaPatient:
    return HovorkaPatient(
        parameters=jax.tree.map(jnp.asarray, with_values(values)),
        basal_insulin_mU_min=jnp.asarray(basal_insulin_mU_min),
        setpoint_mg_dl=jnp.asarray(setpoint_mg_dl),
    )


def sound(x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Whether insulin and glucose of states are physically possible, ``(...)`` each.

    No depot, amount, concentration or effect is ever below zero. Interstitial glucose follows plasma glucose, so that
    it has never been below the lowest of that.

    Parameters
    ----------
    x : (9, ...) array
    lowest_mg_dl : (...) array
        Least plasma glucose so far.
    """
    insulin = jnp.all(x[INSULIN] >= -_ROUNDING, axis=0)
    follows = x[_INTERSTITIAL] * MG_DL_PER_MMOL_L >= lowest_mg_dl - _INTEGRATION_MG_DL
    return insulin, jnp.all(x[GLUCOSE] >= -_ROUNDING, axis=0) & follows


def _populations() -> Mapping[str, Any]:
    from glucoloop.patients.hovorka.populations import POPULATIONS

    return POPULATIONS


HOVORKA_2004_MODEL: Final = PatientModel(
    build=_build,
    operating_points={"fasting-120": lambda: at_setpoint(HOVORKA_2004, 120.0)},
    nominal=NOMINAL,
    populations=_populations,
    meanings=MEANINGS,
    refuse=refuse_impossible,
    sound=sound,
)
