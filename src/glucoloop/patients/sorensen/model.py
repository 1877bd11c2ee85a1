"""Patient of Parker, Doyle and Peppas (1999) as a model: operating points, populations, and bounds that states keep.

Concentrations of insulin and glucagon never fall below zero. Glucose can, in these equations: brain, gut and red cells
take up the same amount however little there is, so hours of too much insulin take even arterial glucose below zero.
What can be promised follows from the balances. Transport of glucose only ever mixes: if arterial glucose has never been
below m, the blood of the brain has never been below ``m - u_B / q_B``, its tissue not below ``m - u_B / q_B -
u_B T_B / v_BI``, and the gut not below ``m - u_G / q_G``: what each takes up at steady state. Elsewhere uptake ends
with glucose, which stays at zero or above as long as m is above what the gut takes up. Rates of uptake do not scale
with body weight while flows and volumes do, so these distances are largest for the lightest person.
"""

from __future__ import annotations

import functools
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.patients.model import PatientModel, Values
from glucoloop.patients.population import Population
from glucoloop.patients.settings import PATIENTS
from glucoloop.patients.sorensen.equations import INSULIN, STATE_NAMES
from glucoloop.patients.sorensen.parameters.parker2000 import LARGEST_VARIATION_PCT, UNCERTAIN
from glucoloop.patients.sorensen.patient import OPERATING_POINTS, SorensenPatient
from glucoloop.patients.sorensen.varying import (
    ADULTS,
    FOLLOWS,
    MEANINGS,
    NOMINAL,
    REFERENCE_WEIGHT_KG,
    STRENGTH,
    WEIGHT,
    refuse_impossible,
    with_values,
)
from glucoloop.patients.variation import Variation

_NAME: Final = "parker-1999"
_SPREAD_CV_PCT: Final = 20.0


def _populations() -> dict[str, Population]:
    """Populations by name."""
    uncertain = (
        Variation(parameter=entry.parameter, distribution="uniform", spread_pct=LARGEST_VARIATION_PCT)
        if entry.half_width is None
        else Variation(parameter=entry.parameter, distribution="uniform", spread=entry.half_width)
        for entry in UNCERTAIN
    )
    lognormal = (
        Variation(
            parameter=entry.parameter,
            distribution="lognormal",
            spread_pct=_SPREAD_CV_PCT,
            # insulin of the periphery could not be cleared beyond 0.243
            upper=0.21 if entry.parameter == "F_PC" else None,
        )
        if entry.half_width is None
        else Variation(parameter=entry.parameter, distribution="normal", spread=_SPREAD_CV_PCT / 100.0)
        for entry in UNCERTAIN
    )
    varied = {"parker2000": tuple(uncertain), "lognormal": (*lognormal, ADULTS)}
    summaries = PATIENTS[_NAME].populations
    return {name: Population(name, which, summaries[name], patient=_NAME) for name, which in varied.items()}


LIGHTEST_KG: Final = ADULTS.around(REFERENCE_WEIGHT_KG).lower
"""Minimum weight of a person in the populations."""
_ROUNDING: Final = 1e-9
_INTEGRATION_MG_DL: Final = 0.1
"""Integration error with two exponential steps per sample, on the way down to these bounds."""
_GLUCAGON: Final = STATE_NAMES.index("N")
_UPTAKE_ENDS: Final = tuple(STATE_NAMES.index(name) for name in ("G_L", "G_K", "G_PV", "G_PI"))


def sound(x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Whether insulin and glucose of states ``(19, ...)`` are possible, by the minimum arterial glucose so far."""
    insulin = jnp.all(x[INSULIN] >= -_ROUNDING, axis=0) & (x[_GLUCAGON] >= -_ROUNDING)
    return insulin, _explained(x, lowest_mg_dl)


def _explained(x: jax.Array, lowest_mg_dl: jax.Array) -> jax.Array:
    """Whether glucose in every organ is within the bounds that follow from the minimum arterial glucose and uptake."""
    n, heavier = NOMINAL, REFERENCE_WEIGHT_KG / LIGHTEST_KG
    brain = heavier * n["brain_uptake"] / n["q_B"]
    tissue = brain + heavier * n["brain_uptake"] * n["T_B"] / n["v_BI"]
    gut = heavier * n["gut_uptake"] / n["q_G"]
    least = lowest_mg_dl - _INTEGRATION_MG_DL
    holds = (x[0] >= least - brain) & (x[1] >= least - tissue) & (x[3] >= least - gut)
    for organ in _UPTAKE_ENDS:
        holds = holds & (x[organ] >= jnp.minimum(least - gut, 0.0))
    return holds


@functools.cache
def _shared(constant: float) -> jax.Array:
    with jax.ensure_compile_time_eval():
        return jnp.asarray(constant)


def _number(value: Any) -> jax.Array:
    """A constant as JAX has it; one that all people share is made once."""
    return _shared(value) if isinstance(value, float) else jnp.asarray(value)


def _build(values: Values, basal_insulin_mU_min: Any, setpoint_mg_dl: Any) -> SorensenPatient:
    return SorensenPatient(
        parameters=jax.tree.map(_number, with_values(values)),
        basal_insulin_mU_min=jnp.asarray(basal_insulin_mU_min),
        setpoint_mg_dl=jnp.asarray(setpoint_mg_dl),
    )


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
