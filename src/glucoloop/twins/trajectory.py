"""Simulation of the people of a family under recorded doses and meals, of which JAX takes derivatives.

The patient is carried by the classical Runge-Kutta method from sample to sample; the doses of a sample are given evenly
over it, and a meal enters each step with its exact moments. The state at the start is the one at steady state at a
glucose near the first reading: by how much it differs is one more coordinate of a twin, and the first hours, in which
the state forgets its start, are not compared with readings.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.meals import Eaten, absorb, meal_model_of
from glucoloop.patients.capabilities import rest_at, seen_mg_dl, sites
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import Population, virtual_people
from glucoloop.refusal import Refusal
from glucoloop.simulation.explicit import ExplicitPlant, fastest_rate_per_min
from glucoloop.twins.days import SAMPLE_MIN, RecordedDays
from glucoloop.twins.prior import Prior

Values = npt.NDArray[np.float64]

_START_SD: Final = 0.2
"""Standard deviation of the logarithm of glucose at the start about the first reading."""
WARM_UP_MIN: Final = 360.0
"""Time from the start in which readings are not used: the state forgets how it was begun."""
_INTERSTITIAL: Final = "interstitial"
_SAMPLED_PEOPLE: Final = 64
_MAX_STEP: Final = 0.8
"""Largest product of a step and the fastest rate."""
_MARGIN: Final = 1.5
_TOGETHER: Final = 64
"""People that are simulated at once."""


@dataclass(frozen=True)
class Simulator:
    """Days of a record for the people of a prior.

    A person is a vector of coordinates: those of the prior, and one of glucose at the start.
    """

    prior: Prior
    days: RecordedDays
    steps: int
    """Steps of a sample."""
    site: str
    """Site of the sensor."""

    @classmethod
    def of(cls, population: Population, prior: Prior, days: RecordedDays) -> Simulator:
        """Simulator with steps that suit the people of a population, some of whom are looked at."""
        some = population if population.table is None else population.drawn_as("with-replacement")
        people = virtual_people(some, 0, np.arange(_SAMPLED_PEOPLE))
        people = people.at(np.flatnonzero(people.feasible))
        if not people.feasible.size:
            raise Refusal(
                f"nobody of {population.name} can rest at the setpoint of {population.patient}; choose another one"
            )
        rate = _MARGIN * fastest_rate_per_min(people.patient)
        where = sites(people.patient)
        return cls(
            prior=prior,
            days=days,
            steps=max(2, math.ceil(rate * SAMPLE_MIN / _MAX_STEP)),
            site=_INTERSTITIAL if _INTERSTITIAL in where else where[0],
        )

    @property
    def coordinates(self) -> int:
        """Number of coordinates of a person."""
        return len(self.prior.parameters) + 1

    def glucose_mg_dl(self, z: Values) -> Values:
        """Glucose at the sensor ``(people, samples + 1)`` of people with coordinates ``(people, coordinates)``."""
        parts = []
        for start in range(0, len(z), _TOGETHER):
            block = z[start : start + _TOGETHER]
            filled = np.concatenate([block, np.zeros((_TOGETHER - len(block), z.shape[1]))])  # one program for all
            parts.append(np.asarray(self._run(filled.T)).T[: len(block)])
        return np.concatenate(parts)

    def with_jacobian(self, z: Values) -> tuple[Values, Values]:
        """Glucose as `glucose_mg_dl`, and its Jacobian ``(people, samples + 1, coordinates)``.

        Each column of the Jacobian has a lane of its own, so that people and columns are computed alike.
        """
        people, coordinates = z.shape
        tangents = np.tile(np.eye(coordinates), people)
        glucose, change = self._run(np.repeat(z, coordinates, axis=0).T, tangents)
        jacobian = np.moveaxis(np.asarray(change).reshape(-1, people, coordinates), 0, 1)
        return np.asarray(glucose)[:, ::coordinates].T, jacobian

    def starts(self, z: Values) -> tuple[dict[str, Values], Values]:
        """Parameters ``(people,)`` by name of people with coordinates, and their states ``(states, people)``."""
        x = self._start(jnp.asarray(z.T), jnp.asarray(self.days.first_mg_dl))[1]
        return self.parameters(self.prior, z), np.asarray(x)

    @staticmethod
    def parameters(prior: Prior, z: Values) -> dict[str, Values]:
        """Parameters ``(people,)`` by name of people with coordinates ``(people, coordinates)``."""
        return {name: np.asarray(value) for name, value in prior.values(jnp.asarray(z.T[:-1])).items()}

    def _start(self, z: jax.Array, first_mg_dl: jax.Array) -> tuple[Any, jax.Array]:
        """People of coordinates ``(coordinates, people)``, and their states at the start."""
        unknown = jnp.full(z.shape[1], jnp.nan)
        people = patient_entry(self.prior.patient).build(self.prior.values(z[:-1]), unknown, unknown)
        _, x = rest_at(people, first_mg_dl * jnp.exp(_START_SD * z[-1]))
        return people, x

    def _course(self, z: jax.Array, given: dict[str, jax.Array]) -> jax.Array:
        """Glucose at the sensor ``(samples + 1, people)``."""
        people, x = self._start(z, given["first_mg_dl"])
        samples = given["insulin"].shape[0]
        step_min = SAMPLE_MIN / self.steps
        plant = ExplicitPlant(patient=people, clock_min=given["clock_min"], step_min=step_min, steps_per_point=1)
        eaten = jax.tree.map(
            lambda values: jnp.broadcast_to(values[:, None], (values.size, z.shape[1])),
            Eaten(t_min=given["meal_min"], carbs_g=given["carbs_g"], eating_min=jnp.zeros_like(given["carbs_g"])),
        )
        moments = absorb(meal_model_of(people), eaten).moments(samples, self.steps, step_min)

        def sample(x: jax.Array, entry: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
            clock, insulin, moments = entry
            seen = seen_mg_dl(people, x, self.site)
            insulin = jnp.broadcast_to(insulin, z.shape[1:])

            def step(
                state: tuple[jax.Array, jax.Array], of_step: jax.Array
            ) -> tuple[tuple[jax.Array, jax.Array], None]:
                x, clock = state
                return (plant.step(x, clock, insulin, of_step), clock + step_min), None

            (x, _), _ = jax.lax.scan(step, (x, clock), moments, unroll=2)
            return x, seen

        clock = given["clock_min"] + SAMPLE_MIN * jnp.arange(samples)
        x, seen = jax.lax.scan(sample, x, (clock, given["insulin"], moments))
        return jnp.concatenate([seen, seen_mg_dl(people, x, self.site)[None]])

    def _run(self, z: Values, tangents: Values | None = None) -> Any:
        """Courses of lanes ``(coordinates, lanes)``, and their changes along tangents if there are any."""
        return _program(self._fixed())(jnp.asarray(z), tangents, self._given(), self._numbers())

    def _fixed(self) -> tuple[Any, ...]:
        prior = self.prior
        return prior.population, prior.patient, prior.parameters, tuple(prior.known), self.steps, self.site

    def _numbers(self) -> tuple[Any, ...]:
        prior = self.prior
        return jnp.asarray(prior.mean), jnp.asarray(prior.factor), tuple(map(float, prior.known.values()))

    def _given(self) -> dict[str, jax.Array]:
        days = self.days
        return {
            "first_mg_dl": jnp.asarray(days.first_mg_dl),
            "insulin": jnp.asarray(days.insulin_mU_min),
            "clock_min": jnp.asarray(days.clock_min),
            "meal_min": jnp.asarray(days.meal_min),
            "carbs_g": jnp.asarray(days.carbs_g),
        }


@functools.lru_cache(maxsize=16)
def _program(fixed: tuple[Any, ...]) -> Any:
    """Program for the people of a prior, whose numbers are arguments so that another person needs no other program."""
    population, patient, parameters, known, steps, site = fixed

    @jax.jit
    def run(z: jax.Array, tangents: jax.Array | None, given: dict[str, jax.Array], numbers: tuple[Any, ...]) -> Any:
        mean, factor, values = numbers
        prior = Prior(population, patient, parameters, mean, factor, dict(zip(known, values, strict=True)))
        simulator = Simulator(prior=prior, days=None, steps=steps, site=site)  # type: ignore[arg-type]  # in `given`

        def trajectory(z: jax.Array) -> jax.Array:
            return simulator._course(z, given)

        return trajectory(z) if tangents is None else jax.jvp(trajectory, (z,), (tangents,))

    return run
