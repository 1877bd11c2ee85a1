"""People of the page: how parameters are drawn, and what follows from these for a person's plant, gut and rest."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, Final, cast
from urllib.parse import urlencode

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri

import glucoloop
from glucoloop._pytree import chosen
from glucoloop.component.setting import choices_text
from glucoloop.lab.lowered_function import PageFunction, page_function
from glucoloop.lab.patient_functions import (
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
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.capabilities import rest_at
from glucoloop.patients.catalogue import PATIENTS, patient_entry
from glucoloop.patients.population import draw
from glucoloop.patients.variation import DISTRIBUTIONS, Distribution
from glucoloop.refusal import Refusal
from glucoloop.simulation.people_plant import PATH, doublings_for, rates
from glucoloop.situations.population import named_population
from glucoloop.threefry import name_word

_MAX_PEOPLE: Final = 10_000
"""Largest number of people whom the page simulates at once."""
_UNIFORM, _LOGNORMAL = DISTRIBUTIONS.index("uniform"), DISTRIBUTIONS.index("lognormal")
_MAX_OPERATIONS: Final = 5000
"""Length of a person's function up to which it finds the rest too. The page has a shorter search for longer ones."""


def draw_function() -> PageFunction:
    """A parameter of a person by a uniform number, as `glucoloop.patients.variation` draws it."""

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del person, rng
        distribution = shared
        deviation = distribution["scale"] * ndtri(distribution["below"] + distribution["between"] * own)
        value = jnp.where(
            distribution["kind"] == _LOGNORMAL,
            distribution["centre"] * jnp.exp(deviation),
            distribution["centre"] + deviation,
        )
        flat = distribution["lower"] + (distribution["upper"] - distribution["lower"]) * own
        return carry, jnp.clip(
            jnp.where(distribution["kind"] == _UNIFORM, flat, value), distribution["lower"], distribution["upper"]
        )

    zero = jnp.zeros(())
    names = ("between", "below", "centre", "kind", "lower", "scale", "upper")
    return page_function(step, (), (), zero, dict.fromkeys(names, zero))


def _distribution(distribution: Distribution) -> dict[str, float]:
    """A distribution as a draw takes it."""
    below, above = (0.0, 0.0) if distribution.kind == "uniform" else distribution.probabilities
    return {
        "kind": DISTRIBUTIONS.index(distribution.kind),
        "centre": distribution.centre,
        "scale": distribution.scale,
        "lower": distribution.lower,
        "upper": distribution.upper,
        "below": below,
        "between": above - below,
    }


@functools.cache
def person_function(family: str) -> PageFunction:
    """Function of a person's parameters that gives what the page needs of the person.

    These are the numbers of the patient and of the gut in which people differ, and the rates of insulin; and where rest
    is found in few operations, the basal rate, the state and glucose there, NaN if no rate holds the setpoint.
    """
    with_rest = _person_function(family, rests=True)
    return (
        with_rest
        if len(with_rest.scalar.program.operations) <= _MAX_OPERATIONS
        else _person_function(family, rests=False)
    )


def _person_function(family: str, *, rests: bool) -> PageFunction:
    point = PATIENTS.find(family).default_operating_point
    setpoint_mg_dl = float(patients(family)[point].setpoint_mg_dl)
    states = plants(family)[point].matrices.driven_end.shape[0]
    names, build = list(people_of(family).distributions()), patient_entry(family).build

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del person, shared, rng
        patient = cast(SemilinearPatient, build(dict(zip(names, own, strict=True)), jnp.nan, setpoint_mg_dl))
        result = {
            "numbers": jnp.stack(chosen(patient, patients_vary(family))),
            "gut": gut_numbers(patient, family),
            "rates": rates(jax.tree.map(lambda leaf: leaf[..., None], patient), states)[:-1, :, 0],
        }
        if rests:
            basal_insulin_mU_min, x = rest_at(patient, jnp.asarray(setpoint_mg_dl))
            result |= {"basal_insulin_mU_min": basal_insulin_mU_min, "x": x, "glucose_mg_dl": patient.glucose_mg_dl(x)}
        return carry, result

    return page_function(step, (), (), [jnp.zeros(())] * len(names))


def people_numbers(family: str) -> dict[str, Any]:
    """Distributions of the people of a family, and constants of their plants, as the page reads them."""
    point = PATIENTS.find(family).default_operating_point
    return {
        "population": people_of(family).name,
        "seed": SEED,
        "patient": patient_id(family, point),
        "count": _MAX_PEOPLE,
        "parameters": [
            {"word": name_word(f"parameter {name}"), "distribution": _distribution(distribution)}
            for name, distribution in people_of(family).distributions().items()
        ],
        "driven": driven_places(family),
        "doublings": doublings_for(patients(family)[point], STEP_MIN),
        "step_min": STEP_MIN,
        "path": PATH.tolist(),
    }


_MAX_OWN_PEOPLE: Final = 200
"""Largest number of people whom a page carries."""


def with_people(data: dict[str, Any], family: str, population: str) -> dict[str, Any]:
    """Data of the page with a population in the place of the default one of a family; it opens with that family.

    Person by person they are those of ``glucoloop trial`` with the seed of the page. Of a file only the name is shown.
    """
    families = data["people"]
    if family not in families:
        raise Refusal(f"the page has no people around {family}; give --patient {choices_text(tuple(families))}")
    people, names = named_population(population, family), list(people_of(family).distributions())
    if set(people.parameters) != set(names):
        raise Refusal(
            f"the people of {population} differ in {', '.join(people.parameters) or 'nothing'}; people of the page "
            f"differ in {', '.join(names)}: give a population that has each of these, as a twin of {family} has"
        )
    count = min(people.most_people or _MAX_OWN_PEOPLE, _MAX_OWN_PEOPLE)
    values = draw(people, SEED, np.arange(count)).values
    parameters = np.stack([values[name] for name in names], axis=1).tolist()
    own = {**families[family], "population": Path(population).name, "count": count, "given": parameters}
    opens = {"glucoloop": glucoloop.__version__, "patient": family} | ({"follow": "0"} if count == 1 else {})
    return {**data, "people": {**families, family: own}, "open": f"#{urlencode(opens)}"}
