"""Patients of the page with their meals, as functions of one step of the integrator of `glucoloop run`.

The matrices of the exponential integrator are inputs of the function, so that it depends on formulas alone and not on
how a library rounded; only what is zero at all operating points is known to it. A patient of equations alone is
carried by the explicit integrator, and has no matrices.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, Final, cast

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import chosen, replaced, varying
from glucoloop.lab.lowered_function import PageFunction, page_function, start_function
from glucoloop.meals.absorption import fasting
from glucoloop.meals.linear import moments_of_jumps
from glucoloop.meals.models import meal_model_of
from glucoloop.meals.ode import OdeDigestion, eaten_of
from glucoloop.meals.protocol import Eaten, LinearMealModel, OdeMealModel
from glucoloop.native.interpreter import interpret
from glucoloop.patients import Population, SemilinearPatient, population, virtual_people
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.patients.population import of_people
from glucoloop.refusal import Refusal
from glucoloop.simulation import exponential
from glucoloop.simulation.explicit import ExplicitPeople
from glucoloop.simulation.exponential import Exponential, ExponentialPlant, Matrices
from glucoloop.simulation.people_plant import PeoplePlant
from glucoloop.simulation.plant import SampleGrid
from glucoloop.simulation.user_objects import goes_fast
from glucoloop.situations.situation import Situation, configured

_Places = Sequence[np.ndarray[Any, np.dtype[np.int64]] | None]

FAMILIES: Final = ("parker-1999", "hovorka-2004", "wilinska-2010", "uva-padova-2008", "kanderian-2009")
"""Families of patients of the page, the default one first."""
SAMPLE_TIME_MIN: Final = 5.0
GRID: Final = SampleGrid(sample_time_min=SAMPLE_TIME_MIN, samples=1)
_POINT_MIN: Final = float(GRID.inside_min[0])
"""Time from a point of the fine grid to the next."""
_INTEGRATOR: Final = Exponential()
_STEPS: Final = _INTEGRATOR.steps_of(GRID)
"""Steps of the integrator in a sample."""
STEP_MIN: Final = SAMPLE_TIME_MIN / _STEPS
SEED: Final = 0
"""Seed of the people, who are those of ``glucoloop trial --seed 0``."""


def situation(family: str, operating_point: str, *sensor: str) -> Situation:
    """Situation of a patient of the page with the default pump, and exact readings unless a sensor is named.

    The page designs on every model that is identified, as `allow_unusual` does.
    """
    patient = {"name": family, "operating_point": operating_point}
    config: Situation = configured(Situation, patient=patient, sensor=list(sensor), allow_unusual=True)
    return config


def patient_id(family: str, operating_point: str) -> str:
    """Name by which the page knows a patient."""
    return f"{family}/{operating_point}"


@functools.cache
def patients(family: str) -> dict[str, SemilinearPatient]:
    """Patients of a family by operating point."""
    points = [point.name for point in PATIENTS.find(family).operating_points]
    return {point: cast(SemilinearPatient, situation(family, point).nominal) for point in points}


def by_equations(family: str) -> bool:
    """Whether the patients of a family are given by their equations alone, and carried by the explicit integrator."""
    return not goes_fast(next(iter(patients(family).values())))


@functools.cache
def people_of(family: str) -> Population:
    """Population whose people the page simulates beside the default patient of a family, as ``glucoloop trial``."""
    return population(PATIENTS.find(family).default_population, patient=family)


@functools.cache
def _varied(family: str) -> SemilinearPatient:
    """The patients of a family and some people of the page, whose numbers trail where any of them differ."""
    everybody: list[Any] = list(patients(family).values())
    if not by_equations(family):
        people = virtual_people(people_of(family), SEED, [0, 1]).patient
        everybody += [of_people(people, i) for i in range(2)]
    leaves = zip(*(jax.tree.leaves(person) for person in everybody), strict=True)
    joined = [
        each[0] if all(np.array_equal(each[0], other) for other in each[1:]) else jnp.stack(list(each), axis=-1)
        for each in leaves
    ]
    varied: SemilinearPatient = jax.tree.unflatten(jax.tree.structure(everybody[0]), joined)
    return varied


@functools.cache
def _explicit(family: str) -> ExplicitPeople:
    """Patients that are given by their equations with the integrator, whose steps are short enough for all of them."""
    return ExplicitPeople(next(iter(patients(family).values())), _varied(family), GRID)


def steps_of(family: str) -> int:
    """Steps of the integrator in a sample."""
    return _explicit(family).substeps if by_equations(family) else _STEPS


@functools.cache
def plants(family: str) -> dict[str, ExponentialPlant]:
    """Patients with the integrator, by operating point.

    They are those of ``glucoloop run``, with the matrices that people need besides who differ in transport or volume.
    """
    result = {}
    for name, patient in patients(family).items():
        plant, _ = _INTEGRATOR.prepare(patient, fasting(), GRID)
        of_people = PeoplePlant(patient, _varied(family), GRID, _STEPS).single.matrices
        matrices = dataclasses.replace(plant.matrices, transport=of_people.transport, probe=of_people.probe)
        result[name] = dataclasses.replace(plant, matrices=matrices)
    return result


def patients_vary(family: str) -> list[bool]:
    """Whether each leaf of a patient differs between people or operating points."""
    return varying(_varied(family), next(iter(patients(family).values())))


@functools.cache
def _matrices(family: str, operating_point: str) -> Matrices:
    """Matrices of a step, with the rows of all steps of a sample one below the other."""
    matrices = plants(family)[operating_point].matrices
    return dataclasses.replace(matrices, dense=matrices.dense.reshape(1, -1, *matrices.dense.shape[2:]))


@functools.cache
def _places(family: str) -> _Places:
    """Places of each matrix that are not zero at all operating points; None for what holds no real numbers."""
    result: list[np.ndarray[Any, np.dtype[np.int64]] | None] = []
    every = (jax.tree.leaves(_matrices(family, name)) for name in patients(family))
    for leaves in zip(*every, strict=True):
        each = [np.ravel(np.asarray(leaf)) for leaf in leaves]
        result.append(np.flatnonzero(np.any(each, axis=0)) if each[0].dtype == float else None)
    return result


def driven_places(family: str) -> list[int]:
    """Places that are not zero in the matrices of insulin, which differ between people: the end, then the path.

    They are the first of the matrices in `plant_numbers`.
    """
    first, path = _places(family)[:2]
    end = next(iter(plants(family).values())).matrices.driven_end
    if first is None or path is None:
        raise ValueError(f"the matrices of insulin of {family} are no real numbers")
    return [*first.tolist(), *(end.size + path).tolist()]


def plant_numbers(family: str, operating_point: str) -> dict[str, list[float]]:
    """Numbers of a patient and of the integrator's matrices, as the plant takes them: what is always zero is left out.

    A zero that is known costs nothing.
    """
    patient = chosen(patients(family)[operating_point], patients_vary(family))
    numbers = [float(leaf) for leaf in patient]
    if by_equations(family):
        return {"numbers": numbers, "matrices": []}
    leaves = zip(jax.tree.leaves(_matrices(family, operating_point)), _places(family), strict=True)
    nonzero_numbers = [np.ravel(np.asarray(leaf))[nonzero] for leaf, nonzero in leaves if nonzero is not None]
    return {"numbers": numbers, "matrices": np.concatenate(nonzero_numbers).tolist()}


def _filled(matrices: Matrices, places: _Places, numbers: jax.Array) -> Matrices:
    """Matrices with other numbers in the places that are not zero."""
    leaves, structure = jax.tree.flatten(matrices)
    new, start = [], 0
    for leaf, nonzero in zip(leaves, places, strict=True):
        if nonzero is None:
            new.append(leaf)
            continue
        flat = jnp.zeros(leaf.size).at[nonzero].set(numbers[start : start + nonzero.size])
        new.append(flat.reshape(leaf.shape))
        start += nonzero.size
    filled: Matrices = jax.tree.unflatten(structure, new)
    return filled


def inside(family: str) -> list[tuple[int, int]]:
    """Step and place of each reading of the fine grid among those that the plant gives at a step."""
    if by_equations(family):
        per_point = _explicit(family).single.steps_per_point
        return [((place + 1) * per_point - 1, 0) for place in range(GRID.inside_min.size)]
    matrices = next(iter(plants(family).values())).matrices
    most = matrices.dense.shape[1]
    return [(int(place) // most, int(place)) for place in np.asarray(matrices.wanted)]


def _adjusted(family: str, person: dict[str, Any]) -> tuple[SemilinearPatient, Matrices]:
    """A patient and the matrices with other numbers, in the order of `plant_numbers`; JAX traces it.

    The rows of the matrices that read glucose are those of all steps of a sample, one below the other.
    """
    first = next(iter(patients(family)))
    return _patient_of(family, person), _filled(_matrices(family, first), _places(family), person["matrices"])


def _patient_of(family: str, person: dict[str, Any]) -> SemilinearPatient:
    """A patient with other numbers, in the order of `plant_numbers`; JAX traces it."""
    patient: SemilinearPatient = replaced(
        next(iter(patients(family).values())), patients_vary(family), person["patient"]
    )
    return patient


def _example_person(family: str) -> dict[str, Any]:
    """Numbers of a patient as `_adjusted` takes them."""
    first, nominal = next(iter(patients(family).items()))
    numbers = plant_numbers(family, first)
    return {
        "patient": chosen(nominal, patients_vary(family)),
        "matrices": jnp.asarray(numbers["matrices"], float),
    }


def portable_glucose_mg_dl(family: str, operating_point: str, x: jax.Array) -> float:
    """Glucose of a patient in a state, rounded as the functions of the page round."""

    def read(person: Any, own: Any, rng: Any) -> Any:
        del rng
        return _patient_of(family, person).glucose_mg_dl(own)

    lowered = start_function(read, _example_person(family), x).scalar
    numbers = plant_numbers(family, operating_point)
    person = np.array([*numbers["matrices"], *numbers["numbers"]])[:, None]
    _, [[glucose]] = interpret(lowered, person=person, own=np.asarray(x)[:, None])
    return float(glucose)


def plant_function(family: str) -> PageFunction:
    """The patient for one step of the integrator: from the infusion to the state and to glucose on the way there.

    It gives the readings of all steps of a sample; `inside` tells which of them are those of a step.
    """

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        patient, matrices = _adjusted(family, person)
        dense, rate = matrices.dense[0], own["insulin_mU_min"]
        x, glucose = exponential.step(patient, matrices, dense, carry, rate, own["moments"])
        return x, {"glucose_mg_dl": patient.glucose_mg_dl(x), "inside_mg_dl": glucose}

    def explicit_step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del rng
        plant = dataclasses.replace(_explicit(family).single, patient=_patient_of(family, person))
        x = plant.step(carry, shared["t_min"], own["insulin_mU_min"], own["moments"])
        glucose = plant.patient.glucose_mg_dl(x)
        return x, {"glucose_mg_dl": glucose, "inside_mg_dl": glucose[None]}

    nominal = next(iter(patients(family).values()))
    x = nominal.steady_state(nominal.basal_insulin_mU_min)
    own = {"insulin_mU_min": jnp.zeros(()), "moments": jnp.zeros(3)}
    if by_equations(family):
        return page_function(explicit_step, _example_person(family), x, own, {"t_min": jnp.zeros(())})
    return page_function(step, _example_person(family), x, own)


@functools.cache
def _gut_varies(family: str) -> list[bool]:
    """Whether each number of the gut differs between people."""
    nominal = next(iter(patients(family).values()))
    return varying(meal_model_of(_varied(family), None), meal_model_of(nominal, None))


def gut_numbers(patient: SemilinearPatient, family: str) -> list[jax.Array]:
    """Numbers of a patient's gut, as a meal takes them."""
    return chosen(meal_model_of(patient, None), _gut_varies(family))


def meal_functions(family: str) -> dict[str, PageFunction]:
    """Functions of the meals of a family by their names, from what is eaten to the moments that the plant takes.

    Where meals superpose, it is one function: the moments of one meal over a step, which the page adds up. A gut that
    is given by its equations has two, for a point of the fine grid: what of one meal is eaten in it, which the page
    adds up, and the gut, carried over the point by all that is eaten, with the moments of the steps in it.
    """
    nominal = meal_model_of(next(iter(patients(family).values())), None)
    if isinstance(nominal, OdeMealModel):
        return {"eaten": _eaten_function(), "gut": _gut_function(family, nominal)}
    return {"meal": _superposed_function(family, nominal)}


def _one_meal() -> Eaten:
    zero = jnp.zeros(())
    return Eaten(t_min=zero, carbs_g=zero, eating_min=zero)


def _as_meals(meal: Eaten) -> Eaten:
    meals: Eaten = jax.tree.map(lambda number: number[None], meal)
    return meals


def _superposed_function(family: str, nominal: LinearMealModel) -> PageFunction:
    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del own, rng
        gut: LinearMealModel = replaced(nominal, _gut_varies(family), person["gut"])
        jumps = gut.jumps(_as_meals(person["meal"]))
        return carry, moments_of_jumps(gut, jumps, shared, SAMPLE_TIME_MIN / steps_of(family))

    numbers = chosen(nominal, _gut_varies(family))
    return page_function(step, {"meal": _one_meal(), "gut": numbers}, (), (), jnp.zeros(()))


def _eaten_function() -> PageFunction:
    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del own, rng
        return carry, eaten_of(_as_meals(person["meal"]), shared[None], _POINT_MIN)[0]

    return page_function(step, {"meal": _one_meal()}, (), (), jnp.zeros(()))


def _gut_function(family: str, nominal: OdeMealModel) -> PageFunction:
    steps, left = divmod(steps_of(family), GRID.inside_min.size)
    if left or np.any(nominal.init()):
        raise Refusal(f"the page cannot carry the gut of {family}: it starts at zero, with whole steps in each point")

    def step(person: Any, carry: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del shared, rng
        gut: OdeMealModel = replaced(nominal, _gut_varies(family), person)
        return OdeDigestion(model=gut, substeps=steps, sample_time_min=_POINT_MIN).sample(carry, own[None])

    return page_function(step, chosen(nominal, _gut_varies(family)), nominal.init(), jnp.zeros(2))
