"""Explicit integrator of any patient: the classical Runge-Kutta method, with steps that end where glucose is recorded.

The infusion is constant over a sample, exercise and what a rhythm changes are so to the next recorded moment, and the
meal enters each step as the quadratic with its exact moments, so that the method keeps its fourth order where a meal is
smooth. Meals that begin at whole minutes begin between two steps. The number of steps follows from the patient's
fastest rate at steady state, beyond which the method would not be stable.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree, static, varying
from glucoloop.arguments import ArgumentTypeError, at_once, checked, is_traced
from glucoloop.meals.absorption import Absorption
from glucoloop.meals.moments import at_start_middle_end
from glucoloop.patients.protocol import Patient, inputs_of
from glucoloop.refusal import Refusal
from glucoloop.simulation.plant import NO_MINUTE_INPUTS, Exogenous, MinuteInputs, SampleGrid
from glucoloop.simulation.user_objects import Content, compiled_by_class

DEFAULT_STEPS_PER_MIN: Final = 2
_MAX_STEPS_PER_MIN: Final = 20
_STABLE: Final = 2.4
"""Largest product of a step and a rate; the method itself is stable up to 2.78 on the real axis."""


@pytree
class ExplicitPlant:
    """A patient that is advanced by equal steps; implements `Plant`."""

    patient: Patient
    clock_min: jax.Array | float
    """Time of day at the start, after midnight."""
    step_min: float = static()
    steps_per_point: int = static()
    """Steps from a moment of the fine grid to the next."""

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array, exogenous: Exogenous) -> tuple[jax.Array, jax.Array]:
        """State after one sample, and glucose on the fine grid inside it."""
        moments, start = exogenous.moments, jnp.asarray(self.clock_min + exogenous.t_min)
        assert moments is not None
        of_points = moments.reshape(-1, self.steps_per_point, *moments.shape[1:])

        def point(carry: tuple[jax.Array, jax.Array], entry: tuple[jax.Array, MinuteInputs]) -> tuple[Any, jax.Array]:
            (x, clock), (moments, minute_inputs) = carry, entry
            for of_step in moments:
                x, clock = self.step(x, clock, insulin_mU_min, of_step, minute_inputs), clock + self.step_min
            return (x, clock), self.patient.glucose_mg_dl(x)

        minute_inputs = exogenous.minute_inputs.at_glucose(self.patient.glucose_mg_dl(x))
        (x, _), inside = jax.lax.scan(point, (x, start), (of_points, minute_inputs))
        return x, inside

    def step(
        self,
        x: jax.Array,
        t_min: jax.Array,
        insulin_mU_min: jax.Array,
        moments: jax.Array,
        minute_inputs: MinuteInputs = NO_MINUTE_INPUTS,
    ) -> jax.Array:
        """State after one step from a time of day on, with the moments ``(3, ...)`` of the meals over the step."""
        patient = minute_inputs.of(self.patient)

        def rate(t: jax.Array, x: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
            return patient.derivative(t, x, minute_inputs.inputs(insulin_mU_min, meal_mg_min))

        h = self.step_min
        start, middle, end = at_start_middle_end(moments)
        k_1 = rate(t_min, x, start)
        k_2 = rate(t_min + h / 2.0, x + h / 2.0 * k_1, middle)
        k_3 = rate(t_min + h / 2.0, x + h / 2.0 * k_2, middle)
        k_4 = rate(t_min + h, x + h * k_3, end)
        return x + h / 6.0 * (k_1 + 2.0 * (k_2 + k_3) + k_4)


@checked
@dataclass(frozen=True)
class Explicit:
    """The integrator for patients of whom nothing but the derivative is known.

    Parameters
    ----------
    steps_per_min : int, optional
        Steps of a minute; by default 2, or more where the patient's fastest rate at steady state asks for it.
    """

    steps_per_min: int | None = None

    def __post_init__(self) -> None:
        if self.steps_per_min is not None and not 1 <= self.steps_per_min:
            raise Refusal(f"steps_per_min of {self.steps_per_min} is not possible; give 1 or more")

    def steps_per_point(self, patient: Patient, grid: SampleGrid) -> int:
        """Steps from a moment of the fine grid of samples to the next; refuses a patient that is too fast for them."""
        point_min = float(grid.inside_min[0])
        wanted = DEFAULT_STEPS_PER_MIN if self.steps_per_min is None else self.steps_per_min
        steps = math.ceil(wanted * point_min - 1e-9)
        if is_traced(patient):
            if self.steps_per_min is None:
                raise ArgumentTypeError(
                    "the patient is traced by JAX, so that its fastest rate, from which the steps follow, has no "
                    f"value; give them, as in integrator=Explicit(steps_per_min={DEFAULT_STEPS_PER_MIN})"
                )
            return steps
        fastest = fastest_rate_per_min(patient)
        needed = math.ceil(fastest * point_min / _STABLE - 1e-9)
        if needed <= steps:
            return steps
        if self.steps_per_min is not None:
            raise Refusal(
                f"{self.steps_per_min} steps per minute are too few for {type(patient).__name__}, whose fastest rate "
                f"at steady state is {fastest:.3g} per minute; give {math.ceil(fastest / _STABLE)} or more, or none"
            )
        if needed > _MAX_STEPS_PER_MIN * point_min:
            raise Refusal(
                f"the fastest rate of {type(patient).__name__} at steady state is {fastest:.3g} per minute, for which "
                f"the explicit integrator would need {math.ceil(fastest / _STABLE)} steps per minute, more than "
                f"{_MAX_STEPS_PER_MIN}; put the fast states at their equilibrium, or use the adaptive integrator"
            )
        return needed

    def prepare(self, patient: Patient, absorption: Absorption, grid: SampleGrid) -> tuple[ExplicitPlant, Exogenous]:
        """The patient with its steps, and the moments of meals ``(samples, steps, 3, ...)`` and times of samples.

        Raises
        ------
        ValueError
            For a patient whose fastest rate at steady state asks for shorter steps than were given, or than are of use.
        """
        plant = plant_with(patient, self.steps_per_point(patient, grid), grid)
        steps = plant.steps_per_point * grid.inside_min.size
        moments = absorption.moments(grid.samples, steps, plant.step_min)
        return plant, Exogenous(t_min=jnp.asarray(grid.t_min), moments=moments)

    def at_sample(
        self, plant: ExplicitPlant, absorption: Absorption, grid: SampleGrid, index: jax.Array
    ) -> tuple[ExplicitPlant, Exogenous, Any]:
        """The same plant, the meals' moments and the time of the sample with a number, and the gut after it."""
        steps = plant.steps_per_point * grid.inside_min.size
        moments, gut = absorption.at_sample(index, steps, plant.step_min)
        return plant, Exogenous(t_min=index * grid.sample_time_min, moments=moments), gut


def plant_with(patient: Patient, steps_per_point: int, grid: SampleGrid) -> ExplicitPlant:
    """A patient with a number of steps on a grid."""
    return ExplicitPlant(
        patient=patient,
        clock_min=grid.start_min,
        step_min=float(grid.inside_min[0]) / steps_per_point,
        steps_per_point=steps_per_point,
    )


def fastest_rate_per_min(patient: Patient) -> float:
    """Largest absolute eigenvalue of the derivative's Jacobian at steady state, of one person or of many."""
    return _fastest(Content(patient))


@functools.lru_cache(maxsize=64)
def _fastest(content: Content) -> float:
    patient: Patient = content.tree
    with at_once():
        x = patient.steady_state(patient.basal_insulin_mU_min)
        jacobian = np.asarray(_jacobian(patient, x, jnp.asarray(patient.basal_insulin_mU_min)))
    rates = np.linalg.eigvals(np.moveaxis(jacobian, (0, 1), (-2, -1)))
    if not np.all(np.isfinite(rates)):
        raise Refusal(
            f"the derivative of {type(patient).__name__} at steady state is not finite; look at it and the constants"
        )
    return float(np.max(np.abs(rates)))


@compiled_by_class
def _jacobian(patient: Patient, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
    """Jacobian of the derivative at steady state at midnight, ``(states, states, ...)``."""
    none = jnp.zeros_like(insulin_mU_min)

    def derivative(x: jax.Array) -> jax.Array:
        return patient.derivative(jnp.zeros(()), x, inputs_of(insulin_mU_min, none))

    def along(direction: jax.Array) -> jax.Array:
        tangent = jnp.broadcast_to(direction.reshape(-1, *[1] * (x.ndim - 1)), x.shape)
        change: jax.Array = jax.jvp(derivative, (x,), (tangent,))[1]
        return change

    return jax.vmap(along, out_axes=1)(jnp.eye(x.shape[0]))


class ExplicitPeople:
    """Plants of people of one kind; implements `PlantsOfPeople`."""

    def __init__(self, nominal: Patient, varied: Patient, grid: SampleGrid, substeps: int | None = None) -> None:
        points = grid.inside_min.size
        per_point = max(Explicit().steps_per_point(varied, grid), math.ceil((substeps or 0) / points))
        self.single = plant_with(nominal, per_point, grid)
        self.step_min, self.substeps = self.single.step_min, per_point * points
        self.varies = [*varying(varied, nominal), False]

    def of(self, patient: Patient) -> ExplicitPlant:
        """Plants of people."""
        return ExplicitPlant(**{**vars(self.single), "patient": patient})
