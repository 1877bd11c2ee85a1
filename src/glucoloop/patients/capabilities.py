"""Optional properties of a patient beyond the protocol, with their defaults.

Each function asks the patient for an attribute of the function's name.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop.component.routes import INTRAVENOUS, PumpRange, route_of
from glucoloop.patients.component import PatientComponent
from glucoloop.patients.protocol import Patient
from glucoloop.refusal import Refusal

DEFAULT_SITE: Final = "plasma"


def lowest_valid_glucose_mg_dl(patient: Patient) -> jax.Array | float:
    """Glucose `()` or `(people,)` below which a patient's model only says that glucose is very low.

    The default is 0 mg/dl, below which there is no concentration.
    """
    limit: jax.Array | float = getattr(patient, "lowest_valid_glucose_mg_dl", 0.0)
    return limit


def takes_exercise(patient: Patient) -> bool:
    """Whether the derivative makes something of ``inputs.exercise_pct``; by default it does not."""
    declared: bool = getattr(patient, "takes_exercise", False)
    return declared


def refuse_glucagon(patient: Any, called: str = "") -> None:
    """Refuse glucagon of a patient whose equations have no infusion of it."""
    if not getattr(patient, "takes_glucagon", False):
        raise Refusal(
            f"the equations of {called or type(patient).__name__} have no infusion of glucagon, so it would change "
            "nothing; leave it out, or take a patient that has it, such as parker-1999 or wilinska-2010-glucagon"
        )


def paced(
    patient: Patient, sensitivity: jax.Array | None = None, production_mg_kg_min: jax.Array | None = None
) -> Patient:
    """The patient with sensitivity to insulin times a factor, and some production of glucose more; None changes none.

    Which constants these are the patient says, one of a record or a table of constants named ``parameters``:
    ``insulin_sensitivity`` has the names of those that are proportional to it, and ``glucose_production`` what 1
    mg/kg/min adds to each of those that are production.

    Raises
    ------
    ValueError
        For a patient that declares no such constants.
    """
    if sensitivity is None and production_mg_kg_min is None:
        return patient
    constants: Any = patient.parameters  # type: ignore[attr-defined]  # whoever declares constants has them
    table = constants if isinstance(constants, dict) else vars(constants)
    changed: dict[str, Any] = {}
    if sensitivity is not None:
        changed = {name: table[name] * sensitivity for name in declared_by(patient, "insulin_sensitivity")}
    if production_mg_kg_min is not None:
        for name, of_1_mg_kg_min in declared_by(patient, "glucose_production").items():
            changed[name] = changed.get(name, table[name]) + of_1_mg_kg_min * production_mg_kg_min
    new = {**table, **changed} if isinstance(constants, dict) else dataclasses.replace(constants, **changed)
    if isinstance(patient, PatientComponent):
        return patient.replaced(parameters=new)
    return dataclasses.replace(patient, parameters=new)  # type: ignore[type-var]


def declared_by(patient: Patient, what: str, called: str = "") -> Any:
    """Constants that a patient declares as ``insulin_sensitivity`` or ``glucose_production``; Refusal without any."""
    declared = getattr(patient, what, None)
    if not declared:
        raise Refusal(
            f"{called or type(patient).__name__} does not declare which of its constants are its "
            f"{what.replace('_', ' ')} ({what}), so a rhythm cannot change them; leave the rhythm out, "
            "or take another patient"
        )
    return declared


def insulin_route(patient: Patient) -> str:
    """Route by which insulin enters the body, one of `component.routes.ROUTES`; by default it enters a vein."""
    declared: str = getattr(patient, "insulin_route", INTRAVENOUS)
    return declared


def usual_pump(patient: Patient) -> PumpRange:
    """Rates of the pump that is usual for a patient; by default those that are usual for its route of insulin."""
    declared: PumpRange | None = getattr(patient, "usual_pump", None)
    return route_of(insulin_route(patient)).pump if declared is None else declared


def sites(patient: Patient) -> tuple[str, ...]:
    """Sites at which glucose can be read, that of the controlled glucose first; by default only that one."""
    declared: tuple[str, ...] = getattr(patient, "sites", (DEFAULT_SITE,))
    return declared


def seen_mg_dl(patient: Patient, x: jax.Array, site: str | None) -> jax.Array:
    """Glucose of a state at the site of a sensor; None is the site of the controlled glucose."""
    if site is None or site == sites(patient)[0]:
        return patient.glucose_mg_dl(x)
    seen: jax.Array = patient.seen_mg_dl(x, site)  # type: ignore[attr-defined]  # who has another site has it
    return seen


def process_noise(patient: Patient, glucose: float, other: float, glucagon: float) -> npt.NDArray[np.float64]:
    """Diagonal of Q `(states,)` of a filter, from variances per sample of three kinds of states.

    By default each state has the variance of glucose in proportion to the squares of both at steady state, whatever its
    unit.
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
        result: tuple[jax.Array, jax.Array] = of_patient(glucose_mg_dl)
        return result
    rate = jnp.asarray(patient.insulin_for(glucose_mg_dl))
    return rate, patient.steady_state(rate)
