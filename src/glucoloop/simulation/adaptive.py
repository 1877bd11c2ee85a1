"""Reference integrator for any patient: adaptive Runge-Kutta of eighth order that stops at every meal jump.

A gut given by its equations is integrated together with the body, from one moment of the fine grid to the next, since
what it remembers jumps there.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import jax
import jax.numpy as jnp
import lazy_loader

from glucoloop._kept_programs import kept_jit
from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.meals.absorption import Absorption
from glucoloop.meals.linear import LinearAbsorption, SampleMeals, meals_of_sample, meals_of_samples
from glucoloop.meals.ode import OdeAbsorption
from glucoloop.meals.protocol import LinearMealModel, OdeMealModel
from glucoloop.patients.protocol import Patient
from glucoloop.simulation.plant import NO_MINUTE_INPUTS, Exogenous, MinuteInputs, SampleGrid

diffrax: Any = lazy_loader.load("diffrax")
"""Imported when an adaptive step is first taken: it takes a sixth of all imports, and few runs need it."""


_MAX_STEPS: Final = 4096
"""Largest number of steps from one sample to the next through which derivatives are taken."""


@pytree
class _Appearing(Exogenous):
    """Inputs of a patient in one sample, with the meals that a linear gut absorbs in it."""

    meals: SampleMeals


@pytree
class _AdaptivePlant:
    """A patient with a linear gut; implements `Plant`."""

    patient: Patient
    model: LinearMealModel
    inside_min: jax.Array
    clock_min: jax.Array | float
    """Time of day at the start, after midnight."""
    tolerance: float = static()

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array, exogenous: Exogenous) -> tuple[jax.Array, jax.Array]:
        """State after one sample, and glucose on the fine grid inside it."""
        assert isinstance(exogenous, _Appearing)
        start, meals = exogenous.t_min, exogenous.meals
        minute_inputs = exogenous.minute_inputs.at_glucose(self.patient.glucose_mg_dl(x))
        if not minute_inputs.names:
            states = self._between(x, insulin_mU_min, start, self.inside_min, minute_inputs, meals)
        else:
            from_min = jnp.concatenate([jnp.zeros(1), self.inside_min[:-1]])

            def point(x: jax.Array, entry: tuple[jax.Array, jax.Array, MinuteInputs]) -> tuple[jax.Array, jax.Array]:
                after, to, minute_inputs = entry
                [x] = self._between(x, insulin_mU_min, start + after, (to - after)[None], minute_inputs, meals)
                return x, x

            _, states = jax.lax.scan(point, x, (from_min, self.inside_min, minute_inputs))
        return states[-1], jax.vmap(self.patient.glucose_mg_dl)(states)

    def _between(
        self,
        x: jax.Array,
        insulin_mU_min: jax.Array,
        start: jax.Array,
        after_min: jax.Array,
        minute_inputs: MinuteInputs,
        meals: SampleMeals,
    ) -> jax.Array:
        """States at times after a start, under inputs that are held from there to the last of them."""
        states: jax.Array = _solved(
            _body_rates, self, x, start, after_min, meals.jumps.t_min, (insulin_mU_min, minute_inputs, meals)
        )
        return states


@pytree
class Fed(Exogenous):
    """Inputs of a patient in one sample, with the gut that feeds it."""

    gut: jax.Array
    """State of the gut at the sample."""
    eaten: jax.Array
    """(points, 2, ...) amount eaten in each point of the fine grid, and whether a meal begins there."""


@pytree
class _AdaptiveGutPlant:
    """A patient with a gut given by its equations; implements `Plant`."""

    patient: Patient
    model: OdeMealModel
    inside_min: jax.Array
    clock_min: jax.Array | float
    """Time of day at the start, after midnight."""
    tolerance: float = static()

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array, exogenous: Exogenous) -> tuple[jax.Array, jax.Array]:
        """State after one sample, and glucose on the fine grid inside it."""
        assert isinstance(exogenous, Fed)
        minute_inputs = exogenous.minute_inputs.at_glucose(self.patient.glucose_mg_dl(x))
        (x, _), states = self._points(_body_and_gut_rates, x, exogenous, insulin_mU_min, minute_inputs)
        return x, jax.vmap(self.patient.glucose_mg_dl)(states)

    def digested(self, outside: Fed) -> jax.Array:
        """State of the gut after one sample."""
        gut: jax.Array
        (_, gut), _ = self._points(_gut_rates, jnp.zeros((0, *outside.gut.shape[1:])), outside, jnp.zeros(()))
        return gut

    def _points(
        self,
        rates: Callable[..., Any],
        x: jax.Array,
        outside: Fed,
        insulin_mU_min: jax.Array,
        minute_inputs: MinuteInputs = NO_MINUTE_INPUTS,
    ) -> Any:
        """Body and gut after one sample, and the body at the points inside it."""
        point_min = self.inside_min[0]

        def point(carry: Any, entry: Any) -> Any:
            (x, gut, start), (eaten_mg, begins, minute_inputs) = carry, entry
            gut = self.model.at_point(gut, eaten_mg, begins > 0.0)
            inputs = (insulin_mU_min, minute_inputs, eaten_mg / point_min)
            states = _solved(rates, self, (x, gut), start, point_min[None], jnp.zeros(0), inputs)
            x, gut = jax.tree.map(lambda state: state[-1], states)
            return (x, gut, start + point_min), x

        (x, gut, _), states = jax.lax.scan(
            point, (x, outside.gut, outside.t_min), (outside.eaten[:, 0], outside.eaten[:, 1], minute_inputs)
        )
        return (x, gut), states


def _body_rates(t: jax.Array, x: jax.Array, known: tuple[_AdaptivePlant, Any]) -> jax.Array:
    plant, (insulin_mU_min, minute_inputs, meals) = known
    inputs = minute_inputs.inputs(insulin_mU_min, meals.appearance_mg_min(t, plant.model))
    rates: jax.Array = minute_inputs.of(plant.patient).derivative(plant.clock_min + t, x, inputs)
    return rates


def _gut_rates(t: jax.Array, both: Any, known: tuple[_AdaptiveGutPlant, Any]) -> tuple[jax.Array, jax.Array]:
    plant, (_, _, eaten_mg_min) = known
    return both[0], plant.model.derivative(both[1], eaten_mg_min)


def _body_and_gut_rates(t: jax.Array, both: Any, known: tuple[_AdaptiveGutPlant, Any]) -> tuple[jax.Array, jax.Array]:
    plant, (insulin_mU_min, minute_inputs, _) = known
    x, gut = both
    inputs = minute_inputs.inputs(insulin_mU_min, plant.model.appearance_mg_min(gut))
    return minute_inputs.of(plant.patient).derivative(plant.clock_min + t, x, inputs), _gut_rates(t, both, known)[1]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _solved(
    rates: Callable[..., Any],
    plant: Any,
    x: Any,
    start: jax.Array,
    after_min: jax.Array,
    jumps_min: jax.Array,
    inputs: Any,
) -> Any:
    """States at moments after a start, the last of which is the end, under ``rates(t, x, (plant, inputs))``.

    The solution takes as many steps as it needs, none across a jump, in a loop that JAX cannot differentiate. Its
    derivatives, in either mode, are those of at most `_MAX_STEPS` such steps.
    """
    return _states(rates, plant, x, start, after_min, jumps_min, inputs, max_steps=None)


@_solved.defjvp
def _solved_jvp(rates: Callable[..., Any], primals: Any, tangents: Any) -> Any:
    of_known = functools.partial(_states, rates, max_steps=_MAX_STEPS, adjoint=diffrax.DirectAdjoint())
    return jax.jvp(of_known, primals, tangents)


def _states(
    rates: Callable[..., Any],
    plant: Any,
    x: Any,
    start: jax.Array,
    after_min: jax.Array,
    jumps_min: jax.Array,
    inputs: Any,
    **loop: Any,
) -> Any:
    end = start + after_min[-1]
    steps = diffrax.PIDController(rtol=plant.tolerance, atol=plant.tolerance)
    if jumps_min.size:
        # outside the sample a jump is of no concern: sorted, each lies at its place or at the end
        inside = jnp.sort(jnp.where((jumps_min > start) & (jumps_min < end), jumps_min, end))
        steps = diffrax.ClipStepSizeController(steps, jump_ts=inside)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        diffrax.Dopri8(),
        start,
        end,
        after_min[-1] / 50.0,
        x,
        (plant, inputs),
        saveat=diffrax.SaveAt(ts=start + after_min),
        stepsize_controller=steps,
        **loop,
    )
    assert solution.ys is not None
    return solution.ys


@checked
@dataclass(frozen=True)
class Adaptive:
    """The adaptive integrator.

    Parameters
    ----------
    tolerance : float
        Relative and absolute local error.
    """

    tolerance: float = 1e-9

    def prepare(
        self, patient: Patient, absorption: Absorption, grid: SampleGrid
    ) -> tuple[_AdaptivePlant | _AdaptiveGutPlant, Exogenous]:
        """The patient with the meals or the gut, and the time and the state of the gut at each sample."""
        common: dict[str, Any] = {
            "patient": patient,
            "inside_min": jnp.asarray(grid.inside_min),
            "clock_min": grid.start_min,
        }
        times = jnp.asarray(grid.t_min)
        if isinstance(absorption, LinearAbsorption):
            plant = _AdaptivePlant(**common, model=absorption.model, tolerance=self.tolerance)
            meals = meals_of_samples(absorption, grid.samples, grid.sample_time_min)
            return plant, _Appearing(t_min=times, meals=meals)
        assert isinstance(absorption, OdeAbsorption)
        fed = _AdaptiveGutPlant(**common, model=absorption.model, tolerance=self.tolerance)
        eaten = absorption.eaten_in_run(grid.samples, grid.sample_time_min)
        return fed, _course(fed, absorption.state, eaten, times)

    def at_sample(
        self, plant: Any, absorption: Absorption, grid: SampleGrid, index: jax.Array
    ) -> tuple[_AdaptivePlant | _AdaptiveGutPlant, Exogenous, Any]:
        """The plant, the inputs of the sample with a number, and the gut after it."""
        t_min = index * grid.sample_time_min
        if isinstance(absorption, LinearAbsorption):
            meals = meals_of_sample(absorption, index, grid.sample_time_min)
            gut = absorption.at_sample(index, 1, grid.sample_time_min)[1]
            return plant, _Appearing(t_min=t_min, meals=meals), gut
        assert isinstance(absorption, OdeAbsorption)
        eaten = absorption.eaten_in_sample(index, grid.sample_time_min)
        outside = Fed(t_min=t_min, gut=absorption.state, eaten=eaten)
        return plant, outside, plant.digested(outside)


@kept_jit
def _course(plant: _AdaptiveGutPlant, gut: jax.Array, eaten: jax.Array, t_min: jax.Array) -> Fed:
    """Inputs of all samples of a run, from the course of the gut by itself."""

    def one(gut: jax.Array, entry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, Fed]:
        outside = Fed(t_min=entry[0], gut=gut, eaten=entry[1])
        return plant.digested(outside), outside

    outside: Fed = jax.lax.scan(one, gut, (t_min, eaten))[1]
    return outside
