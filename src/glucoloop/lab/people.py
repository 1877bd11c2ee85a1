"""Distributions of the people of the page, from which it makes each person's plant and rest."""

from __future__ import annotations

from typing import Any, Final

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.lab.body import POPULATION, STEP_MIN, patient_id, patients, patients_vary, plants
from glucoloop.patients import population, virtual_people
from glucoloop.registry.patients import USUAL_PATIENT
from glucoloop.simulation import driven_block
from glucoloop.simulation.people_plant import chosen
from glucoloop.threefry import name_word

PEOPLE: Final = 10_000
"""Largest number of people whom the page simulates at once."""
SEED: Final = 0
"""Seed of the people, who are those of ``glucoloop trial --seed 0``."""
POINT: Final = USUAL_PATIENT.usual_point
"""Operating point around which the people are drawn."""
_EXAMPLES: Final = 64
_EXACT: Final = 1e-13
"""Largest relative difference that the rounding of the fit explains."""
_DIGITS: Final = 14


def people_numbers() -> dict[str, Any]:
    """Distributions and numbers of the people of the usual patient's population, as the page reads them.

    Raises
    ------
    ValueError
        If a parameter is not drawn uniformly, or a number of a person is no simple function of one parameter.
    """
    family = USUAL_PATIENT.name
    nominal = patients(family)[POINT]
    states = plants(family)[POINT].matrices.driven_end.shape[0]
    table = population(POPULATION).distributions()
    people = virtual_people(population(POPULATION), SEED, range(_EXAMPLES))
    rates = np.asarray(driven_block.rates(people.patient, states))
    own = [np.broadcast_to(np.asarray(leaf), _EXAMPLES) for leaf in chosen(people.patient, patients_vary(family))]
    basal = len(own) - 2  # the page finds it with the state at rest
    alone = jax.tree.map(lambda leaf: np.asarray(leaf)[..., None], nominal)
    drawn = list(people.draw.values.values())
    if any(of.kind != "uniform" for of in table.values()):
        raise ValueError(f"the page draws uniform numbers only, and {POPULATION} has others")
    return {
        "population": POPULATION,
        "seed": SEED,
        "patient": patient_id(family, POINT),
        "count": PEOPLE,
        "parameters": [
            {"word": name_word(f"parameter {name}"), "lower": of.lower, "width": of.upper - of.lower}
            for name, of in table.items()
        ],
        "numbers": [
            [place, *_of_parameter(values, drawn)]
            for place, values in enumerate(own)
            if place != basal and np.ptp(values) > 0.0
        ],
        "entries": [
            [place, *_of_parameter(values, drawn)]
            for place, values in enumerate(rates.reshape(-1, _EXAMPLES))
            if np.ptp(values) > 0.0
        ],
        "rates": np.asarray(driven_block.rates(alone, states))[..., 0].tolist(),
        "doublings": driven_block.doublings_for(nominal, STEP_MIN),
        "step_min": STEP_MIN,
        "path": driven_block.PATH.tolist(),
    }


def _of_parameter(
    values: npt.NDArray[np.float64], drawn: list[npt.NDArray[np.float64]]
) -> tuple[int, float, float, float]:
    """Parameter v and numbers by which a number of each person is ``(a + b v) / (1 + c v)``.

    Raises
    ------
    ValueError
        If there are none.
    """
    for which, v in enumerate(drawn):
        for terms in ([v], [np.ones_like(v), v], [np.ones_like(v), v, -v * values]):
            fitted = np.linalg.lstsq(np.stack(terms, axis=-1), values, rcond=None)[0]
            found = [float(f"{term:.{_DIGITS}g}") for term in fitted]
            a, b, c = ((0.0, *found, 0.0), (*found, 0.0), found)[len(terms) - 1]
            if np.allclose((a + b * v) / (1.0 + c * v), values, rtol=_EXACT, atol=0.0):
                return which, a, b, c
    raise ValueError("a number of the people depends on their parameters in a way that the page does not know")
