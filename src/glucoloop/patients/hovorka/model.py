"""The patient of Hovorka et al. (2004) as a model: operating points, populations, and what may vary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.patients.hovorka.parameters.hovorka2004 import HOVORKA_2004
from glucoloop.patients.hovorka.patient import HovorkaPatient, at_setpoint
from glucoloop.patients.model import PatientModel, Values

_ROUNDING: Final = 1e-9


def _build(values: Values, basal_insulin_mU_min: Any, setpoint_mg_dl: Any) -> HovorkaPatient:
    del values
    return HovorkaPatient(
        parameters=HOVORKA_2004,
        basal_insulin_mU_min=jnp.asarray(basal_insulin_mU_min),
        setpoint_mg_dl=jnp.asarray(setpoint_mg_dl),
    )


def sound(x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Whether insulin, and whether glucose, of states can be: no depot, concentration or effect is ever below zero."""
    del lowest_mg_dl
    there = x >= -_ROUNDING
    return jnp.all(there[3:], axis=0), jnp.all(there[:3], axis=0)


def _populations() -> Mapping[str, Any]:
    return {}


HOVORKA_2004_MODEL: Final = PatientModel(
    build=_build,
    operating_points={"fasting-120": lambda: at_setpoint(HOVORKA_2004, 120.0)},
    populations=_populations,
    sound=sound,
)
