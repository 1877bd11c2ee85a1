"""People of a campaign and their meals, each a function of the seed and the person's number alone."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.limits import LARGEST_COUNTER
from glucoloop.meals import Eaten
from glucoloop.parts.patients import USUAL_PATIENT
from glucoloop.patients.population import Population, VirtualPeople, populations_of, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.threefry import uniforms

MOST_MEALS: Final = 4
_CHUNK: Final = 1024

Array = npt.NDArray[Any]


def _populations(patient: str) -> list[Population]:
    """Populations from which people are drawn in turn; the nominal one where the patient has no other."""
    nominal, *others = populations_of(patient).values()
    return others or [nominal]


def population_of(person: int, patient: str = USUAL_PATIENT.name) -> Population:
    """Population from which a person is drawn."""
    populations = _populations(patient)
    return populations[person % len(populations)]


def draw_people(seed: int, person: npt.ArrayLike, patient: str = USUAL_PATIENT.name) -> VirtualPeople:
    """People drawn from a patient's populations in turn, by their numbers; drawn values are those of the last one."""
    number = np.asarray(person, np.int64)
    each = [virtual_people(population, seed, number) for population in _populations(patient)]
    turn = number % len(each)

    def choose(*of_each: Any) -> Any:
        if not any(jnp.ndim(one) for one in of_each):
            return of_each[0]
        return jnp.asarray(np.select([turn == i for i in range(len(of_each))], [np.asarray(one) for one in of_each]))

    def choose_values(*of_each: Array) -> Array:
        return np.asarray(np.select([turn == i for i in range(len(of_each))], of_each))

    return dataclasses.replace(
        each[-1],
        patient=jax.tree.map(choose, *(one.patient for one in each)),
        basal_insulin_mU_min=choose_values(*(one.basal_insulin_mU_min for one in each)),
        rest=choose_values(*(one.rest for one in each)),
        feasible=choose_values(*(one.feasible for one in each)),
    )


def feasible_people(seed: int, wanted: int, patient: str = USUAL_PATIENT.name) -> npt.NDArray[np.int64]:
    """Numbers of the first people who have a basal rate.

    Raises
    ------
    ValueError
        If there are not as many.
    """
    found: list[npt.NDArray[np.int64]] = []
    for start in range(0, LARGEST_COUNTER, _CHUNK):
        if sum(map(len, found)) >= wanted:
            return np.concatenate(found)[:wanted]
        with one_at_a_time:
            feasible = draw_people(seed, np.arange(start, min(start + _CHUNK, LARGEST_COUNTER)), patient).feasible
        found.append(start + np.flatnonzero(feasible))
    raise Refusal(f"seed {seed} has fewer than {wanted} people; give fewer loops")


def draw_random_meals(seed: int, person: npt.ArrayLike, horizon_min: float) -> Eaten:
    """Meals, at most four ``(4, n)`` of 5 to 120 g at any time, eaten at once; a meal of 0 g counts as none."""
    many = np.floor((MOST_MEALS + 1) * uniforms(seed, "meals", person))
    which = np.arange(MOST_MEALS)
    t_min = np.stack([horizon_min * uniforms(seed, "when", person, int(i)) for i in which])
    carbs_g = np.stack([5.0 + 115.0 * uniforms(seed, "how much", person, int(i)) for i in which])
    carbs_g = np.where(which[:, None] < many, carbs_g, 0.0)
    return Eaten(t_min=t_min, carbs_g=carbs_g, eating_min=np.zeros_like(carbs_g))
