"""Virtual people around the nominal patient.

A population says how people differ: parameters that vary independently or jointly, and a table of named people. Person
i of seed s is a function of the two numbers and the population alone: each parameter has random numbers of its own, by
its name, so that one more line leaves the others as they are. The basal rate of a person is found in chunks of one
size, whoever else is drawn, so that it too is the same to the bit.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._kept_programs import kept_jit
from glucoloop._representation import represented
from glucoloop.arguments import checked, on_host
from glucoloop.meals.protocol import Eaten
from glucoloop.patients.capabilities import rest_at
from glucoloop.patients.catalogue import patient, patient_entry
from glucoloop.patients.component import NOMINAL, PatientComponent
from glucoloop.patients.protocol import Patient
from glucoloop.patients.table import REPLACED, PeopleTable
from glucoloop.patients.variation import Distribution, JointVariation, Values, Variation
from glucoloop.refusal import MissingExtraError, Refusal
from glucoloop.therapy import Profile
from glucoloop.threefry import checked_counter, checked_people, uniforms

MAX_VARIATIONS: Final = 100
_DIGITS: Final = 11
_CHUNK: Final = 512
_WEIGHT: Final = "weight_kg"
P = TypeVar("P", bound=Patient | Profile)


@represented
@dataclass(frozen=True)
class Population:
    """Differences between people around the nominal patient.

    Raises
    ------
    ValueError
        For a parameter that is unknown or given twice, or values that can make an impossible person.
    """

    name: str
    variations: tuple[Variation | JointVariation, ...] = ()
    """Parameters that vary, each independently, or several jointly."""
    summary: str = ""
    patient: str = "parker-1999"
    """Name of the nominal patient."""
    table: PeopleTable | None = None
    """Named people, with the parameters that the table has."""

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise Refusal("a population has no name; give it one")
        if len(self.variations) > MAX_VARIATIONS:
            raise Refusal(f"{len(self.variations)} variations are too many; give at most {MAX_VARIATIONS}")
        model = patient_entry(self.patient)
        seen: set[str] = set()
        for parameter in self.parameters:
            model.refuse_unknown(parameter)
            if parameter in seen:
                raise Refusal(f"{parameter} is varied twice; leave one out")
            seen.add(parameter)
        drawn = self._drawn()
        if self.table is None:
            model.refuse_impossible(drawn)
            return
        for row, name in enumerate(self.table.names):
            try:
                model.refuse_impossible({**drawn, **self.table.only(row).distributions()})
            except Refusal as error:
                raise error.within(f"person {name!r}") from None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters in which people differ, in their order."""
        result: list[str] = []
        for variation in self.variations:
            result += variation.parameters if isinstance(variation, JointVariation) else [variation.parameter]
        return (*result, *(() if self.table is None else self.table.values))

    def _drawn(self) -> dict[str, Distribution]:
        nominal = patient_entry(self.patient).nominal
        result: dict[str, Distribution] = {}
        for variation in self.variations:
            if isinstance(variation, JointVariation):
                result |= variation.distributions(nominal)
            else:
                result[variation.parameter] = variation.around(nominal[variation.parameter])
        return result

    def distributions(self) -> dict[str, Distribution]:
        """Distribution of each parameter by itself, in their order; of a table the range of its values."""
        return {**self._drawn(), **({} if self.table is None else self.table.distributions())}

    def values(self, seed: int, person: npt.NDArray[np.int64]) -> dict[str, Values]:
        """Value ``(n,)`` of each parameter for persons by their numbers."""
        nominal = patient_entry(self.patient).nominal
        result: dict[str, Values] = {}
        for variation in self.variations:
            if isinstance(variation, JointVariation):
                result |= variation.values(nominal, seed, person)
            else:
                name = variation.parameter
                result[name] = variation.around(nominal[name]).values(uniforms(seed, f"parameter {name}", person))
        if self.table is not None:
            rows = self.table.rows(seed, person)
            result |= {name: np.asarray(values, float)[rows] for name, values in self.table.values.items()}
        return result

    def names(self, seed: int, person: npt.ArrayLike) -> list[str] | None:
        """Names of persons by their numbers; None without a table of people."""
        table = self.table
        return None if table is None else [table.names[row] for row in table.rows(seed, checked_people(person))]

    def called(self, seed: int, person: Iterable[int]) -> list[str]:
        """Numbers of persons as texts, each with the name of one who has a name: ``1 (named 2)``."""
        numbers = list(person)
        names = self.names(seed, np.asarray(numbers, np.int64))
        return (
            list(map(str, numbers))
            if names is None
            else [f"{number} (named {name})" for number, name in zip(numbers, names, strict=True)]
        )

    @property
    def most_people(self) -> int | None:
        """Number of people that there are, where each is drawn once; None for any number."""
        return None if self.table is None or self.table.draws == REPLACED else len(self.table.names)

    def refuse_beyond(self, last: int) -> None:
        """Refuse the number of a person whom the population does not have."""
        if self.table is not None:
            try:
                self.table.refuse_beyond(last)
            except Refusal as error:
                ways = (remedy.replace("'NAME,", f"'{self.name},") for remedy in error.remedies)
                raise Refusal(f"population {self.name}: {error.problem}", *ways) from None

    def drawn_as(self, draws: str) -> Population:
        """The same people, drawn ``"once"`` each or ``"with-replacement"``; Refusal without a table of people."""
        if self.table is None:
            raise Refusal(f"the population {self.name} has no table of people, and is drawn again; leave draw out")
        return replace(self, table=replace(self.table, draws=draws))

    def alone(self, person: str, seed: int = 0) -> Population:
        """One person, whoever is drawn: of the table by name, else the one of a number, whom the seed draws."""
        if self.table is not None:
            number = self.table.row(person)
            one = self.table.only(number)
        elif person.isascii() and person.isdecimal() and len(person) < _DIGITS:
            number, one = int(person), PeopleTable(names=(person,), draws=REPLACED)
        else:
            raise Refusal(f"the people of {self.name} have no names; give a number from 0, like person=17")
        drawn = replace(self, table=None).values(seed, checked_people([number]))
        own = {name: (float(values[0]),) for name, values in drawn.items()}
        one = replace(one, values={**own, **one.values})
        who = f"person {one.names[0]} of {self.name}"
        return Population(who, (), f"of seed {seed}" if own else self.summary, self.patient, one)


def populations_of(patient: str) -> dict[str, Population]:
    """Populations by name around a patient that need no other package: the nominal one first."""
    other = patient_entry(patient).of_other_packages
    return {name: population(name, patient=patient) for name in population_names(patient) if name not in other}


def population_names(patient: str) -> tuple[str, ...]:
    """Names of all populations around a patient, also of those that are read from another package."""
    return (NOMINAL, *patient_entry(patient).populations)


@checked
def population(name: str, *, patient: str = "parker-1999") -> Population:
    """Population of a patient by its name.

    Raises
    ------
    ValueError
        For an unknown name, a population of another patient, or one that is read from a package that is not installed.
    """
    names = population_names(patient)
    if name not in names:
        raise Refusal(f"unknown population {name!r} of {patient}; the known ones are: {', '.join(names)}")
    if name == NOMINAL:
        return Population(NOMINAL, (), "the nominal patient, whoever is drawn", patient=patient)
    return replace(patient_entry(patient).population(name), patient=patient)


def is_preset(people: Population) -> bool:
    """Whether a population is the one that its patient has by the same name."""
    if people.name not in population_names(people.patient):
        return False
    try:
        return population(people.name, patient=people.patient) == people
    except MissingExtraError:
        return False


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
    population.refuse_beyond(int(people.max(initial=-1)))
    return Draw(person=people, values=population.values(seed, people))


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
    """``(states, n)`` steady state under the basal rate; NaN where there is none."""
    feasible: npt.NDArray[np.bool_]
    """``(n,)`` whether a basal rate exists."""
    profile: Profile
    """``(n,)`` profiles, as whoever doses insulin knows the people."""

    def at(self, place: npt.NDArray[np.intp]) -> VirtualPeople:
        """The people at the given places, in their order; places may repeat."""
        return replace(
            self,
            draw=Draw(self.draw.person[place], {name: values[place] for name, values in self.draw.values.items()}),
            patient=of_people(self.patient, place),
            basal_insulin_mU_min=self.basal_insulin_mU_min[place],
            rest=self.rest[:, place],
            feasible=self.feasible[place],
            profile=of_people(self.profile, place),
        )


def of_people(of_all: P, place: Any) -> P:
    """Patient or profile of the people at the given places, or of one person; what all share is unchanged."""
    some: P = jax.tree.map(lambda leaf: leaf[place] if jnp.ndim(leaf) else leaf, of_all)
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
        Glucose at steady state under the basal rate; that of the nominal patient's usual operating point by default.

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
        people = patient_entry(population.patient).build(drawn.values, basal, np.full(basal.shape, setpoint_mg_dl))
    return VirtualPeople(
        name=population.patient,
        draw=drawn,
        patient=people,
        basal_insulin_mU_min=basal,
        rest=rest,
        feasible=np.isfinite(basal),
        profile=_profile(population, seed, drawn, basal, setpoint_mg_dl),
    )


def alone(population: Population, setpoint_mg_dl: float) -> tuple[Patient, Profile]:
    """The one person of a population at a setpoint, with the profile; Refusal for a person whom no rate holds there."""
    one = virtual_people(population, 0, [0], setpoint_mg_dl=setpoint_mg_dl)
    person = of_people(one.patient, 0)
    if not one.feasible[0]:
        person.insulin_for(setpoint_mg_dl)  # its own sentence says which glucose can be held
        raise Refusal(f"no insulin infusion holds {population.name} at {setpoint_mg_dl:g} mg/dl; give another setpoint")
    return person, of_people(one.profile, 0)


def nominal_profile(name: str, nominal: Patient) -> Profile:
    """Profile of a nominal patient: how it rests, and what its model says."""
    model = patient_entry(name)
    known = {_WEIGHT: model.nominal[_WEIGHT]} if _WEIGHT in model.nominal else {}
    rest = {"basal_mU_min": nominal.basal_insulin_mU_min, "setpoint_mg_dl": nominal.setpoint_mg_dl}
    return Profile(**{**rest, **known, **model.nominal_profile()})


def _profile(population: Population, seed: int, drawn: Draw, basal: Values, setpoint_mg_dl: float) -> Profile:
    """Profile ``(n,)`` of people: what their table has, and where it has nothing, how they rest and what they weigh."""
    result: dict[str, Values] = {"basal_mU_min": basal, "setpoint_mg_dl": np.full(basal.shape, setpoint_mg_dl)}
    weight = drawn.values.get(_WEIGHT, patient_entry(population.patient).nominal.get(_WEIGHT))
    if weight is not None:
        result[_WEIGHT] = np.broadcast_to(weight, basal.shape)
    if population.table is not None:
        rows = population.table.rows(seed, drawn.person)
        for name, known in population.table.profile.items():
            values = np.array([np.nan if value is None else value for value in known])[rows]
            result[name] = np.where(np.isnan(values), result.get(name, np.nan), values)
    return Profile(**result)


def own_meals(population: Population, seed: int, person: npt.ArrayLike) -> Eaten:
    """The own day of persons by their numbers, ``(meals, n)``, of a population with a table of meals.

    A person who eats less often than others has meals of 0 g, which count as none, at the time of the last one.
    """
    table = population.table
    if table is None:
        raise TypeError(f"the population {population.name} has no table of people")
    days = table.days()
    t_min, carbs_g, eating_min = days[:, :, table.rows(seed, checked_people(person))]
    return Eaten(t_min=t_min, carbs_g=carbs_g, eating_min=eating_min)


@functools.cache
def _usual_setpoint(name: str) -> float:
    return float(patient(name).setpoint_mg_dl)


@kept_jit(static_argnums=0)
def _rest_of(
    kind: type[PatientComponent], values: dict[str, jax.Array], setpoint_mg_dl: jax.Array
) -> tuple[jax.Array, jax.Array]:
    return rest_at(kind.build(values, jnp.nan, setpoint_mg_dl), setpoint_mg_dl)


def _at_rest(name: str, drawn: Draw, setpoint_mg_dl: float) -> tuple[Values, Values]:
    """Basal rates ``(n,)`` and states ``(states, n)``, found for whole chunks, the last one filled by repetition."""
    n = drawn.person.size
    parts: list[tuple[Values, Values]] = []
    kind, setpoints = patient_entry(name), np.full(_CHUNK, float(setpoint_mg_dl))
    for start in range(0, max(1, n), _CHUNK):  # nobody has as many states as anybody
        block = slice(start, min(start + _CHUNK, n))
        values = {name: np.resize(value[block], _CHUNK) for name, value in drawn.values.items()}
        basal, rest = (np.asarray(part)[..., : block.stop - start] for part in _rest_of(kind, values, setpoints))
        parts.append((basal, rest))
    return np.concatenate([basal for basal, _ in parts]), np.concatenate([rest for _, rest in parts], axis=-1)
