"""Glucose under a sequence of doses, and its derivative with respect to each dose.

The patient is carried by the exponential integrator of the simulation, with its own meals, so that a plan that is
found here does the same in `simulate`. Several meals can be followed: people trail, and here they are the same person
in several circumstances. They are carried one after the other, so that what is compiled for one serves them all.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.meals import Eaten, Meal, Scenario, absorb, eaten, meal_model_of
from glucoloop.patients.protocol import Patient
from glucoloop.refusal import Refusal
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.integrators import default_integrator
from glucoloop.simulation.minute_inputs import minute_inputs_of
from glucoloop.simulation.plant import Exogenous, MinuteInputs, Plant, SampleGrid
from glucoloop.simulation.user_objects import compiled_by_class

Values = npt.NDArray[np.float64]

_AT_REST_MG_DL: Final = 1e-6
_MEALS_TOGETHER: Final = 3  # numbers of meals are multiples of it, since each number is compiled for


@dataclass(frozen=True)
class RunModel:
    """A patient at the start of a run with the meals to come, in one circumstance or several."""

    plant: Plant
    moments: Values
    """(samples, substeps, 3, members) moments of the meals."""
    minute_inputs: MinuteInputs
    """(samples, points) exercise and what a rhythm changes."""
    state: Values
    """(states, 1) state at the start, at steady state."""
    grid: SampleGrid
    setpoint_mg_dl: float
    resting_mU_min: float
    """Rate at which the patient rests before the run."""

    @property
    def samples(self) -> int:
        """Number of doses of a plan."""
        return self.grid.samples

    @property
    def at_rest(self) -> bool:
        """Whether the patient starts at the setpoint."""
        glucose = self.plant.patient.glucose_mg_dl(jnp.asarray(self.state))
        return bool(abs(float(glucose[0]) - self.setpoint_mg_dl) <= _AT_REST_MG_DL)

    @property
    def members(self) -> int:
        """Number of circumstances that are followed at once."""
        return int(self.moments.shape[-1])

    def of_members(self, *members: int, samples: int | None = None) -> RunModel:
        """The course restricted to some of the circumstances and to the first samples."""
        samples = self.samples if samples is None else samples
        grid = replace(self.grid, samples=samples)
        minute_inputs = jax.tree.map(lambda values: values[:samples], self.minute_inputs)
        return replace(self, moments=self.moments[:samples, ..., list(members)], minute_inputs=minute_inputs, grid=grid)

    def glucose_mg_dl(self, insulin_mU_min: Values) -> Values:
        """Glucose on the fine grid, ``(points, members)``, under doses ``(samples, members)``."""
        return self._of_each(_glucose, insulin_mU_min)

    def sensitivity(self, insulin_mU_min: Values) -> Values:
        """Derivative of glucose with respect to each dose, ``(points, members, samples)``, mg/dl per mU/min."""
        return self._of_each(_sensitivity, insulin_mU_min)

    def _of_each(self, function: Callable[..., jax.Array], insulin_mU_min: Values) -> Values:
        """Values of a function of the run for one member after the other, side by side."""
        one = (
            function(self.plant, self.exogenous(member), self.state, insulin_mU_min[:, [member]])
            for member in range(self.members)
        )
        return np.concatenate(list(one), axis=1)

    def exogenous(self, member: int) -> Exogenous:
        """Meals of a circumstance, exercise and rhythms, sample by sample."""
        moments = jnp.asarray(self.moments[..., [member]])
        return Exogenous(t_min=jnp.asarray(self.grid.t_min), moments=moments, minute_inputs=self.minute_inputs)


def trajectory_of(
    patient: Patient, scenario: Scenario, sample_time_min: float, meals: Sequence[Sequence[Meal]]
) -> RunModel:
    """Model of a scenario with other meals, one list of them for each member."""
    if scenario.warm_up_min:
        raise Refusal("a bound is for a run from rest, without a warm-up; leave the warm-up out")
    grid = sample_grid(scenario.horizon_min, sample_time_min, scenario.start_min)
    most = -(-max(1, *map(len, meals)) // _MEALS_TOGETHER) * _MEALS_TOGETHER
    minute_inputs = minute_inputs_of(patient, scenario, grid)
    gut = meal_model_of(patient, scenario.meal_model)
    integrator = default_integrator(patient, minute_inputs=bool(minute_inputs.names))
    prepared = {
        eaten_meals: integrator.prepare(patient, absorb(gut, _padded(eaten(eaten_meals), most)), grid)
        for eaten_meals in {tuple(eaten_meals) for eaten_meals in meals}
    }
    resting = patient.basal_insulin_mU_min
    if scenario.initial_glucose_mg_dl is not None:
        resting = patient.insulin_for(scenario.initial_glucose_mg_dl)
    setpoint = patient.setpoint_mg_dl if scenario.setpoint_mg_dl is None else scenario.setpoint_mg_dl
    return RunModel(
        plant=prepared[tuple(meals[0])][0],
        moments=np.concatenate([np.asarray(prepared[tuple(eaten_meals)][1].moments) for eaten_meals in meals], axis=-1),
        minute_inputs=minute_inputs,
        state=np.asarray(patient.steady_state(resting))[:, None],
        grid=grid,
        setpoint_mg_dl=float(setpoint),
        resting_mU_min=float(resting),
    )


def _padded(meals: Eaten, most: int) -> Eaten:
    """Meals of one member, padded with meals of 0 g to a common number."""
    padded: Eaten = jax.tree.map(lambda part: np.pad(part, (0, most - part.size))[:, None], meals)
    return padded


@compiled_by_class
def _glucose(plant: Plant, exogenous: Exogenous, state: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
    def one(x: jax.Array, entry: Any) -> tuple[jax.Array, jax.Array]:
        insulin, outside = entry
        return plant.advance(x, insulin, outside)

    _, inside = jax.lax.scan(one, state, (insulin_mU_min, exogenous))
    return jnp.concatenate([plant.patient.glucose_mg_dl(state)[None], inside.reshape(-1, state.shape[1])])


@compiled_by_class
def _sensitivity(plant: Plant, exogenous: Exogenous, state: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
    def along(direction: jax.Array) -> jax.Array:
        of_doses = functools.partial(_glucose, plant, exogenous, state)
        tangent = jnp.broadcast_to(direction[:, None], insulin_mU_min.shape)
        change: jax.Array = jax.jvp(of_doses, (insulin_mU_min,), (tangent,))[1]
        return change

    return jax.vmap(along, out_axes=-1)(jnp.eye(insulin_mU_min.shape[0]))
