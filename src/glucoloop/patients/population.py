"""Virtual people around the nominal patient.

A population is a table of what varies. Person i of seed s is a function of the two numbers and the table alone: each
parameter has random numbers of its own, by its name, so that one more line in the table leaves the others as they are.
The basal rate of a person is found in chunks of one size, whoever else is drawn, so that it too is the same to the bit.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.arguments import checked, on_host
from glucoloop.patients.capabilities import rest_at
from glucoloop.patients.model import patient, patient_model
from glucoloop.patients.protocol import Patient
from glucoloop.patients.settings import NOMINAL
from glucoloop.patients.variation import Distribution, Values, Variation
from glucoloop.refusal import Refusal
from glucoloop.threefry import checked_counter, checked_people, uniforms

MOST_VARIATIONS: Final = 100
_CHUNK: Final = 1024


@dataclass(frozen=True)
class Population:
    """The parameters that vary between people, each independently, around the nominal patient.

    Raises
    ------
    ValueError
        For a parameter that is unknown or given twice, or a table that can make an impossible person.
    """

    name: str
    variations: tuple[Variation, ...] = ()
    summary: str = ""
    patient: str = "parker-1999"
    """Name of the nominal patient."""

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise Refusal("a population has no name; give it one")
        if len(self.variations) > MOST_VARIATIONS:
            raise Refusal(f"{len(self.variations)} variations are too many; give at most {MOST_VARIATIONS}")
        model = patient_model(self.patient)
        seen: set[str] = set()
        for variation in self.variations:
            model.refuse_unknown(variation.parameter)
            if variation.parameter in seen:
                raise Refusal(f"{variation.parameter} is varied twice; leave one out")
            seen.add(variation.parameter)
        model.refuse(self.distributions())

    def distributions(self) -> dict[str, Distribution]:
        """Distribution of each varied parameter, in the order of the table."""
        nominal = patient_model(self.patient).nominal
        return {v.parameter: v.around(nominal[v.parameter]) for v in self.variations}


def populations_of(patient: str) -> dict[str, Population]:
    """Populations by name around a patient: the nominal one first."""
    nominal = Population(NOMINAL, (), "the nominal patient, whoever is drawn", patient=patient)
    others = patient_model(patient).populations()
    return {NOMINAL: nominal, **{name: replace(other, patient=patient) for name, other in others.items()}}


@checked
def population(name: str, *, patient: str = "parker-1999") -> Population:
    """Population of a patient by its name.

    Raises
    ------
    ValueError
        For an unknown name, or a population of another patient.
    """
    known = populations_of(patient)
    if name not in known:
        raise Refusal(f"unknown population {name!r} of {patient}; the known ones are: {', '.join(known)}")
    return known[name]


@dataclass(frozen=True)
class Draw:
    """Drawn values of people."""

    person: npt.NDArray[np.int64]
    """Numbers of the persons, ``(n,)``."""
    values: Mapping[str, Values]
    """Value of each varied parameter, ``(n,)``, in its own unit."""


def draw(population: Population, seed: int, person: npt.ArrayLike) -> Draw:
    """Draw the varied parameters of given persons of a population; arguments and errors as for `virtual_people`."""
    people = checked_people(person)
    checked_counter("seed", seed)
    return Draw(
        person=people,
        values={
            name: distribution.values(uniforms(seed, f"parameter {name}", people))
            for name, distribution in population.distributions().items()
        },
    )


@dataclass(frozen=True)
class VirtualPeople:
    """People with their patient constants and the rates that hold them at the setpoint."""

    name: str
    """Name of the nominal patient."""
    draw: Draw
    patient: Patient
    """Constants with people trailing where they vary; basal rate and setpoint ``(n,)``. All float64."""
    basal_insulin_mU_min: Values
    """``(n,)`` basal rate; NaN where no rate holds the setpoint with glucose above zero everywhere."""
    rest: Values
    """``(states, n)`` state at rest under the basal rate; NaN where there is none."""
    feasible: npt.NDArray[np.bool_]
    """``(n,)`` whether a basal rate exists."""

    def at(self, place: npt.NDArray[np.intp]) -> VirtualPeople:
        """The people at the given places, in their order; places may repeat."""
        return replace(
            self,
            draw=Draw(self.draw.person[place], {name: values[place] for name, values in self.draw.values.items()}),
            patient=of_people(self.patient, place),
            basal_insulin_mU_min=self.basal_insulin_mU_min[place],
            rest=self.rest[:, place],
            feasible=self.feasible[place],
        )


def of_people(patient: Patient, place: Any) -> Patient:
    """Constants of people at the given places, or of one person; shared constants are unchanged."""
    some: Patient = jax.tree.map(lambda leaf: leaf[place] if jnp.ndim(leaf) else leaf, patient)
    return some


@checked
@on_host("random numbers of people are drawn with NumPy")
def virtual_people(
    population: Population, seed: int, person: npt.ArrayLike, *, setpoint_mg_dl: float | None = None
) -> VirtualPeople:
    """Persons of a population at a setpoint, each with an individual basal rate.

    Parameters
    ----------
    seed : int
        Seed, from 0 to 2**32 - 1.
    person : (n,) array of int
        Numbers of the persons, from 0 to 2**32 - 1, in any order.
    setpoint_mg_dl : float, optional
        Glucose at rest under the basal rate; that of the nominal patient's usual operating point by default.

    Returns
    -------
    VirtualPeople
        All persons: one without a basal rate has NaN for it and is not `feasible`.

    Raises
    ------
    ValueError
        For a seed or a person that does not exist, or a setpoint that is not positive and finite.
    """
    if setpoint_mg_dl is None:
        setpoint_mg_dl = _usual_setpoint(population.patient)
    if not 0.0 < setpoint_mg_dl < np.inf:
        raise Refusal(f"a setpoint of {setpoint_mg_dl:g} mg/dl is not possible; give a finite value above 0 mg/dl")
    drawn = draw(population, seed, person)
    with jax.default_device(jax.devices("cpu")[0]):
        basal, rest = _at_rest(population.patient, drawn, setpoint_mg_dl)
        people = patient_model(population.patient).build(drawn.values, basal, np.full(basal.shape, setpoint_mg_dl))
    return VirtualPeople(
        name=population.patient,
        draw=drawn,
        patient=people,
        basal_insulin_mU_min=basal,
        rest=rest,
        feasible=np.isfinite(basal),
    )


@functools.cache
def _usual_setpoint(name: str) -> float:
    return float(patient(name).setpoint_mg_dl)


@functools.partial(jax.jit, static_argnames="name")
def _held(name: str, values: dict[str, jax.Array], setpoint_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    people = patient_model(name).build(values, jnp.nan, setpoint_mg_dl)
    return rest_at(people, setpoint_mg_dl)


def _at_rest(name: str, drawn: Draw, setpoint_mg_dl: float) -> tuple[Values, Values]:
    """Basal rates ``(n,)`` and states ``(states, n)``, found for whole chunks, the last one filled by repetition."""
    n = drawn.person.size
    parts: list[tuple[Values, Values]] = []
    setpoints = np.full(_CHUNK, float(setpoint_mg_dl))
    for start in range(0, max(1, n), _CHUNK):  # nobody has as many states as anybody
        block = slice(start, min(start + _CHUNK, n))
        values = {name: np.resize(value[block], _CHUNK) for name, value in drawn.values.items()}
        basal, rest = (np.asarray(part)[..., : block.stop - start] for part in _held(name, values, setpoints))
        parts.append((basal, rest))
    return np.concatenate([basal for basal, _ in parts]), np.concatenate([rest for _, rest in parts], axis=-1)
