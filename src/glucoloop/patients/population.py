"""Virtual people around the nominal patient.

A population is a table of what varies. Person i of seed s is a function of the two numbers and the table alone: each
parameter has random numbers of its own, by its name, so that one more line in the table leaves the others as they are.
His basal rate is found in chunks of one size, whoever else is asked for, so that it too is the same to the bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.arguments import checked, on_host
from glucoloop.patients.operating_point import SorensenPatient
from glucoloop.patients.parameters.parker2000 import LARGEST_VARIATION_PCT, UNCERTAIN
from glucoloop.patients.rest import rest_at
from glucoloop.patients.sorensen import GLUCOSE, STATE_NAMES
from glucoloop.patients.variation import Distribution, Values, Variation
from glucoloop.patients.varying import NOMINAL, refuse_impossible, refuse_unknown, with_values
from glucoloop.threefry import checked_counter, checked_people, uniforms

DEFAULT_SETPOINT_MG_DL: Final = 81.1
MOST_VARIATIONS: Final = 100
_CHUNK: Final = 1024


@dataclass(frozen=True)
class Population:
    """Who is drawn: the parameters that vary, each independently, around the nominal patient.

    Raises
    ------
    ValueError
        For a parameter that is unknown or given twice, or a table that can make a person who cannot be.
    """

    name: str
    variations: tuple[Variation, ...] = ()
    summary: str = ""

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise ValueError("a population has no name; give it one")
        if len(self.variations) > MOST_VARIATIONS:
            raise ValueError(f"{len(self.variations)} variations are too many; give at most {MOST_VARIATIONS}")
        seen: set[str] = set()
        for variation in self.variations:
            refuse_unknown(variation.parameter)
            if variation.parameter in seen:
                raise ValueError(f"{variation.parameter} is varied twice; leave one out")
            seen.add(variation.parameter)
        refuse_impossible(self.distributions())

    def distributions(self) -> dict[str, Distribution]:
        """Distribution of each varied parameter, in the order of the table."""
        return {v.parameter: v.around(NOMINAL[v.parameter]) for v in self.variations}


_SPREAD_CV_PCT: Final = 20.0
_WEIGHT_CV_PCT: Final = 15.0

PRESETS: Final[dict[str, Population]] = {
    population.name: population
    for population in (
        Population("nominal", (), "the nominal patient, whoever is drawn"),
        Population(
            "parker2000",
            tuple(
                Variation(parameter=of.parameter, distribution="uniform", spread_pct=LARGEST_VARIATION_PCT)
                if of.half_width is None
                else Variation(parameter=of.parameter, distribution="uniform", spread=of.half_width)
                for of in UNCERTAIN
            ),
            "up to 40 % in the eight parameters of Parker et al. (2000), uniform",
        ),
        Population(
            "lognormal",
            (
                *(
                    Variation(
                        parameter=of.parameter,
                        distribution="lognormal",
                        spread_pct=_SPREAD_CV_PCT,
                        # insulin of the periphery could not be cleared beyond 0.243
                        upper=0.21 if of.parameter == "F_PC" else None,
                    )
                    if of.half_width is None
                    else Variation(parameter=of.parameter, distribution="normal", spread=_SPREAD_CV_PCT / 100.0)
                    for of in UNCERTAIN
                ),
                Variation(parameter="weight_kg", distribution="lognormal", spread_pct=_WEIGHT_CV_PCT),
            ),
            "the same eight, lognormal with a coefficient of variation of 20 %, and weight of 70 kg with 15 %",
        ),
    )
}


@checked
def population(name: str) -> Population:
    """Population by its name.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    if name not in PRESETS:
        raise ValueError(f"unknown population {name!r}; the known ones are: {', '.join(PRESETS)}")
    return PRESETS[name]


@dataclass(frozen=True)
class Draw:
    """Who was drawn."""

    person: npt.NDArray[np.int64]
    """Numbers of the persons, ``(n,)``."""
    values: Mapping[str, Values]
    """Value of each varied parameter, ``(n,)``, in its own unit."""


def draw(population: Population, seed: int, person: npt.ArrayLike) -> Draw:
    """Values of the varied parameters of some persons of a population.

    Parameters
    ----------
    population : Population
    seed : int
        From 0 to 2**32 - 1.
    person : (n,) array of int
        Their numbers, from 0 to 2**32 - 1, in any order.

    Raises
    ------
    ValueError
        For a seed or a person that does not exist.
    """
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
    """People with their patient records and the rates that hold them at the setpoint."""

    draw: Draw
    patient: SorensenPatient
    """Constants with people trailing where they vary; basal rate and setpoint ``(n,)``. All float64."""
    basal_insulin_mU_min: Values
    """``(n,)``; NaN where no rate from 0 to 1000 mU/min holds the setpoint with glucose above zero in every organ."""
    rest: Values
    """State at rest under the basal rate, ``(19, n)``; NaN where there is none."""
    able: npt.NDArray[np.bool_]
    """``(n,)``: whether a basal rate exists."""


@checked
@on_host("random numbers of people are drawn with NumPy")
def virtual_people(
    population: Population, seed: int, person: npt.ArrayLike, *, setpoint_mg_dl: float = DEFAULT_SETPOINT_MG_DL
) -> VirtualPeople:
    """Persons of a population at a setpoint, each with his own basal rate.

    Parameters
    ----------
    population : Population
    seed : int
        From 0 to 2**32 - 1.
    person : (n,) array of int
        Their numbers, from 0 to 2**32 - 1, in any order.
    setpoint_mg_dl : float
        Arterial glucose at rest under the basal rate.

    Returns
    -------
    VirtualPeople
        Nobody is left out: a person without a basal rate has NaN for it and is not `able`.

    Raises
    ------
    ValueError
        For a seed or a person that does not exist, or a setpoint that is not positive and finite.
    """
    if not 0.0 < setpoint_mg_dl < np.inf:
        raise ValueError(f"a setpoint of {setpoint_mg_dl:g} mg/dl is not possible; give a finite value above 0 mg/dl")
    drawn = draw(population, seed, person)
    with jax.default_device(jax.devices("cpu")[0]):
        basal, rest = _at_rest(drawn, setpoint_mg_dl)
        patient = SorensenPatient(
            parameters=jax.tree.map(jnp.asarray, with_values(drawn.values)),
            basal_insulin_mU_min=jnp.asarray(basal),
            setpoint_mg_dl=jnp.full(basal.shape, setpoint_mg_dl),
        )
    return VirtualPeople(draw=drawn, patient=patient, basal_insulin_mU_min=basal, rest=rest, able=np.isfinite(basal))


@jax.jit
def _held(values: dict[str, jax.Array], setpoint_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    infusion, state = rest_at(with_values(values), setpoint_mg_dl)
    possible = jnp.all(state[GLUCOSE] > 0.0, axis=0)
    return jnp.where(possible, infusion, jnp.nan), jnp.where(possible, state, jnp.nan)


def _at_rest(drawn: Draw, setpoint_mg_dl: float) -> tuple[Values, Values]:
    """Basal rates ``(n,)`` and states ``(19, n)``, found for whole chunks, the last one filled by repetition."""
    n = drawn.person.size
    basal, rest = np.empty(n), np.empty((len(STATE_NAMES), n))
    setpoints = np.full(_CHUNK, float(setpoint_mg_dl))
    for start in range(0, n, _CHUNK):
        here = slice(start, min(start + _CHUNK, n))
        values = {name: np.resize(value[here], _CHUNK) for name, value in drawn.values.items()}
        of_chunk = [np.asarray(part)[..., : here.stop - start] for part in _held(values, setpoints)]
        basal[here], rest[:, here] = of_chunk
    return basal, rest
