"""People of the page: how parameters are drawn, and what follows from these for a person's plant, gut and rest."""

from __future__ import annotations

import functools
from typing import Any, Final

import jax
import jax.numpy as jnp
from jax.scipy.special import ndtri

from glucoloop.lab.body import (
    SEED,
    STEP_MIN,
    driven_places,
    gut_numbers,
    patient_id,
    patients,
    patients_vary,
    people_of,
    plants,
)
from glucoloop.lab.part import CompiledPart, part
from glucoloop.parts.patients import PATIENTS
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.capabilities import rest_at
from glucoloop.patients.model import patient_model
from glucoloop.patients.variation import DISTRIBUTIONS, Distribution
from glucoloop.simulation import driven_block
from glucoloop.simulation.people_plant import chosen
from glucoloop.threefry import name_word

PEOPLE: Final = 10_000
"""Largest number of people whom the page simulates at once."""
_UNIFORM, _LOGNORMAL = DISTRIBUTIONS.index("uniform"), DISTRIBUTIONS.index("lognormal")
_MOST_OPERATIONS: Final = 5000
"""Length of a person's function up to which it finds the rest too. The page has a shorter search for longer ones."""


def draw_part() -> CompiledPart:
    """A parameter of a person by a uniform number, as `glucoloop.patients.variation` draws it."""

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del person, rng
        of = shared
        deviation = of["scale"] * ndtri(of["below"] + of["between"] * own)
        drawn = jnp.where(of["kind"] == _LOGNORMAL, of["centre"] * jnp.exp(deviation), of["centre"] + deviation)
        flat = of["lower"] + (of["upper"] - of["lower"]) * own
        return carry, jnp.clip(jnp.where(of["kind"] == _UNIFORM, flat, drawn), of["lower"], of["upper"])

    zero = jnp.zeros(())
    names = ("between", "below", "centre", "kind", "lower", "scale", "upper")
    return part(step, (), (), zero, dict.fromkeys(names, zero))


def _distribution(of: Distribution) -> dict[str, float]:
    """A distribution as a draw takes it."""
    below, above = (0.0, 0.0) if of.kind == "uniform" else of.probabilities
    return {
        "kind": DISTRIBUTIONS.index(of.kind),
        "centre": of.centre,
        "scale": of.scale,
        "lower": of.lower,
        "upper": of.upper,
        "below": below,
        "between": above - below,
    }


@functools.cache
def person_part(family: str) -> CompiledPart:
    """Function of a person's parameters that gives what the page needs of the person.

    These are the numbers of the patient and of the gut in which people differ, and the rates of insulin; and where rest
    is found in few operations, the basal rate, the state and glucose there, NaN if no rate holds the setpoint.
    """
    with_rest = _person_part(family, rests=True)
    return (
        with_rest
        if len(with_rest.lowered.program.operations) <= _MOST_OPERATIONS
        else _person_part(family, rests=False)
    )


def _person_part(family: str, *, rests: bool) -> CompiledPart:
    point = PATIENTS[family].usual_point
    setpoint_mg_dl = float(patients(family)[point].setpoint_mg_dl)
    states = plants(family)[point].matrices.driven_end.shape[0]
    names, build = list(people_of(family).distributions()), patient_model(family).build

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del person, shared, rng
        of: SemilinearPatient = build(dict(zip(names, own, strict=True)), jnp.nan, setpoint_mg_dl)
        found = {
            "numbers": jnp.stack(chosen(of, patients_vary(family))),
            "gut": gut_numbers(of, family),
            "rates": driven_block.rates(jax.tree.map(lambda leaf: leaf[..., None], of), states)[:-1, :, 0],
        }
        if rests:
            basal_insulin_mU_min, x = rest_at(of, jnp.asarray(setpoint_mg_dl))
            found |= {"basal_insulin_mU_min": basal_insulin_mU_min, "x": x, "glucose_mg_dl": of.glucose_mg_dl(x)}
        return carry, found

    return part(step, (), (), [jnp.zeros(())] * len(names))


def people_numbers(family: str) -> dict[str, Any]:
    """Distributions of the people of a family, and constants of their plants, as the page reads them."""
    point = PATIENTS[family].usual_point
    return {
        "population": people_of(family).name,
        "seed": SEED,
        "patient": patient_id(family, point),
        "count": PEOPLE,
        "parameters": [
            {"word": name_word(f"parameter {name}"), "distribution": _distribution(of)}
            for name, of in people_of(family).distributions().items()
        ],
        "driven": driven_places(family),
        "doublings": driven_block.doublings_for(patients(family)[point], STEP_MIN),
        "step_min": STEP_MIN,
        "path": driven_block.PATH.tolist(),
    }
