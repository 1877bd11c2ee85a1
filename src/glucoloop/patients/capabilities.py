"""Optional properties of a patient beyond the protocol, with their defaults.

Each function asks the patient for an attribute of the function's name.
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.parts.routes import INTRAVENOUS, PumpRange, route_of
from glucoloop.patients.protocol import Patient

USUAL_SITE: Final = "plasma"


def lowest_valid_glucose_mg_dl(patient: Patient) -> jax.Array | float:
    """Glucose `()` or `(people,)` below which a patient's model only says that glucose is very low.

    The default is 0 mg/dl, below which there is no concentration.
    """
    limit: jax.Array | float = getattr(patient, "lowest_valid_glucose_mg_dl", 0.0)
    return limit


def insulin_route(patient: Patient) -> str:
    """Route by which insulin enters the body, one of `parts.routes.ROUTES`; by default it enters a vein."""
    declared: str = getattr(patient, "insulin_route", INTRAVENOUS)
    return declared


def usual_pump(patient: Patient) -> PumpRange:
    """Rates of the pump that is usual for a patient; by default those that are usual for its route of insulin."""
    declared: PumpRange | None = getattr(patient, "usual_pump", None)
    return route_of(insulin_route(patient)).pump if declared is None else declared


def sites(patient: Patient) -> tuple[str, ...]:
    """Sites at which glucose can be read, that of the controlled glucose first; by default only that one."""
    declared: tuple[str, ...] = getattr(patient, "sites", (USUAL_SITE,))
    return declared


def seen_mg_dl(patient: Patient, x: jax.Array, site: str | None) -> jax.Array:
    """Glucose of a state at the site of a sensor; None is the site of the controlled glucose."""
    if site is None or site == sites(patient)[0]:
        return patient.glucose_mg_dl(x)
    seen: jax.Array = patient.seen_mg_dl(x, site)  # type: ignore[attr-defined]  # who has another site has it
    return seen


def process_noise(patient: Patient, glucose: float, other: float, glucagon: float) -> npt.NDArray[np.float64]:
    """Diagonal of Q `(states,)` of a filter, from variances per sample of three kinds of states.

    By default each state has the variance of glucose in proportion to the squares of both at rest, whatever its unit.
    """
    of_patient = getattr(patient, "process_noise", None)
    if of_patient is not None:
        diagonal: npt.NDArray[np.float64] = of_patient(glucose, other, glucagon)
        return diagonal
    x = patient.steady_state(patient.basal_insulin_mU_min)
    share: npt.NDArray[np.float64] = np.asarray(x / patient.glucose_mg_dl(x), float)
    return glucose * share**2


def rest_at(patient: Patient, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Rate that holds a glucose, and the state there; NaN for people whom no rate holds. JAX traces it."""
    of_patient = getattr(patient, "rest_at", None)
    if of_patient is not None:
        found: tuple[jax.Array, jax.Array] = of_patient(glucose_mg_dl)
        return found
    rate = jnp.asarray(patient.insulin_for(glucose_mg_dl))
    return rate, patient.steady_state(rate)
