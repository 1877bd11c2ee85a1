"""Subjects on whom a tuning is tried: people of a population, and the nominal patient under several noises."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.cohorts.trial import Trial
from glucoloop.experiments.random_keys import keys_of_people
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.population import of_people, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.simulation.people_plant import varying


@dataclass(frozen=True)
class Subjects:
    """Subjects at the start of a run, who trail: people first, then the nominal patient."""

    patient: SemilinearPatient
    rest: npt.NDArray[np.float64]
    """(states, subjects) states at rest."""
    basal_insulin_mU_min: npt.NDArray[np.float64]
    """(subjects,) rates under which they rest."""
    key: jax.Array
    """(subjects,) random key of each sensor."""
    people: int
    """Number of subjects that are people."""
    infeasible: int
    """People who were drawn but have no basal rate, and were left out."""

    def at(self, place: npt.NDArray[np.intp]) -> Subjects:
        """The subjects at the given places, in their order; places may repeat."""
        return dataclasses.replace(
            self,
            patient=of_people(self.patient, place),
            rest=self.rest[:, place],
            basal_insulin_mU_min=self.basal_insulin_mU_min[place],
            key=self.key[place],
        )

    @property
    def number(self) -> int:
        """Number of all subjects."""
        return int(self.basal_insulin_mU_min.size)


def draw_subjects(trial: Trial, *, people: int, people_seed: int, seeds: int, first_seed: int) -> Subjects:
    """Draw people and the noises of the nominal patient, at whose setpoint all rest.

    Persons 0 to ``people - 1`` of a seed have the same noise as in a trial of that seed. The noises of the nominal
    patient are those of ``glucoloop run --seed`` from ``first_seed`` on. Refusal if nobody has a basal rate.
    """
    nominal, population = trial.nominal, trial.population
    setpoint_mg_dl = float(nominal.setpoint_mg_dl)
    drawn = virtual_people(population, people_seed, np.arange(people), setpoint_mg_dl=setpoint_mg_dl)
    feasible = np.flatnonzero(drawn.feasible)
    if not feasible.size:
        raise Refusal(
            f"none of the {people} people of {population.name} has a basal rate that holds {setpoint_mg_dl:g} mg/dl; "
            "choose another population or setpoint"
        )
    leaves, tree = jax.tree.flatten(drawn.patient)
    own = jax.tree.leaves(nominal)
    joined = [
        jnp.concatenate([many[feasible], jnp.broadcast_to(jnp.asarray(one, float), seeds)]) if trails else many
        for many, one, trails in zip(leaves, own, varying(drawn.patient, nominal), strict=True)
    ]
    basal = np.asarray(nominal.basal_insulin_mU_min, float)
    rest = np.asarray(nominal.steady_state(jnp.asarray(basal)), float)
    noise = jax.vmap(jax.random.key)(jnp.arange(first_seed, first_seed + seeds, dtype=jnp.uint32))
    return Subjects(
        patient=jax.tree.unflatten(tree, joined),
        rest=np.concatenate([drawn.rest[:, feasible], np.repeat(rest[:, None], seeds, axis=1)], axis=1),
        basal_insulin_mU_min=np.append(drawn.basal_insulin_mU_min[feasible], np.full(seeds, basal)),
        key=jnp.concatenate([keys_of_people(people_seed, drawn.draw.person[feasible]), noise]),
        people=int(feasible.size),
        infeasible=people - int(feasible.size),
    )
