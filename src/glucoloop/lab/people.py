"""People of the page: what differs between them, as numbers from which the page makes each person's plant and rest."""

from __future__ import annotations

import base64
from typing import Any, Final

import jax
import numpy as np

from glucoloop.lab.body import POPULATION, STEP_MIN, patients, patients_vary, plants
from glucoloop.patients import population, virtual_people
from glucoloop.registry.patients import USUAL_PATIENT
from glucoloop.simulation import driven_block
from glucoloop.simulation.people_plant import chosen

PEOPLE: Final = 1000
SEED: Final = 0
"""Seed of the people, who are those of ``glucoloop trial --seed 0``."""
POINT: Final = USUAL_PATIENT.usual_point
"""Operating point around which the people are drawn."""


def people_numbers() -> dict[str, Any]:
    """Numbers in which the people of the usual patient's population differ, as the page reads them."""
    family = USUAL_PATIENT.name
    nominal = patients(family)[POINT]
    states = plants(family)[POINT].matrices.driven_end.shape[0]
    people = virtual_people(population(POPULATION), SEED, range(PEOPLE))
    rates = np.asarray(driven_block.rates(people.patient, states))
    own = [np.broadcast_to(np.asarray(leaf), PEOPLE) for leaf in chosen(people.patient, patients_vary(family))]
    places = [i for i, numbers in enumerate(own) if np.ptp(numbers) > 0.0]
    entries = [place for place in np.ndindex(rates.shape[:2]) if np.ptp(rates[place]) > 0.0]
    table = np.stack([*(own[i] for i in places), *(rates[place] for place in entries)], axis=1)
    alone = jax.tree.map(lambda leaf: np.asarray(leaf)[..., None], nominal)
    return {
        "population": POPULATION,
        "seed": SEED,
        "operating_point": POINT,
        "count": PEOPLE,
        "feasible": np.flatnonzero(~np.asarray(people.feasible)).tolist(),
        "places": places,
        "entries": [list(place) for place in entries],
        "table": base64.b64encode(np.ascontiguousarray(table, "<f8").tobytes()).decode(),
        "rates": np.asarray(driven_block.rates(alone, states))[..., 0].tolist(),
        "doublings": driven_block.doublings_for(nominal, STEP_MIN),
        "step_min": STEP_MIN,
        "path": driven_block.PATH.tolist(),
    }
