"""Patient of Parker, Doyle and Peppas (1999) as a model: operating points, populations, variable constants."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.patients.model import PatientModel, Values
from glucoloop.patients.sorensen.patient import OPERATING_POINTS, SorensenPatient
from glucoloop.patients.sorensen.soundness import sound
from glucoloop.patients.sorensen.varying import (
    FOLLOWS,
    MEANINGS,
    NOMINAL,
    STRENGTH,
    WEIGHT,
    refuse_impossible,
    with_values,
)


def _build(values: Values, basal_insulin_mU_min: Any, setpoint_mg_dl: Any) -> SorensenPatient:
    return SorensenPatient(
        parameters=jax.tree.map(jnp.asarray, with_values(values)),
        basal_insulin_mU_min=jnp.asarray(basal_insulin_mU_min),
        setpoint_mg_dl=jnp.asarray(setpoint_mg_dl),
    )


def _populations() -> Mapping[str, Any]:
    from glucoloop.patients.sorensen.populations import POPULATIONS

    return POPULATIONS


PARKER_1999_MODEL: Final = PatientModel(
    build=_build,
    operating_points=OPERATING_POINTS,
    nominal=NOMINAL,
    populations=_populations,
    refuse=refuse_impossible,
    follows=FOLLOWS,
    meanings=MEANINGS,
    hint=(
        "the known ones are the constants of the patient, such as F_LC or M_IHGP.inflection, the strength of an "
        f"effect, such as M_IHGP.{STRENGTH}, and {WEIGHT}"
    ),
    sound=sound,
)
