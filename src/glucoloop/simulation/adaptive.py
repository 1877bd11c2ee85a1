"""Reference integrator for any patient: adaptive Runge-Kutta of eighth order that stops at every meal jump."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import diffrax
import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.meals.absorption import Absorption, appearance_mg_min
from glucoloop.patients.protocol import Patient
from glucoloop.simulation.plant import Exogenous, Held, SampleGrid


@pytree
class AdaptivePlant:
    """A patient and its absorbed meals; implements `Plant`."""

    patient: Patient
    absorption: Absorption
    inside_min: jax.Array
    clock_min: jax.Array | float
    """Time of day at the start, after midnight."""
    tolerance: float = static()

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array, exogenous: Exogenous) -> tuple[jax.Array, jax.Array]:
        """State after one sample, and glucose on the fine grid inside it."""
        start, held = exogenous.t_min, exogenous.held
        if not held.names:
            states = self._between(x, insulin_mU_min, start, self.inside_min, held)
        else:
            from_min = jnp.concatenate([jnp.zeros(1), self.inside_min[:-1]])

            def point(x: jax.Array, entry: tuple[jax.Array, jax.Array, Held]) -> tuple[jax.Array, jax.Array]:
                after, to, held = entry
                [x] = self._between(x, insulin_mU_min, start + after, (to - after)[None], held)
                return x, x

            _, states = jax.lax.scan(point, x, (from_min, self.inside_min, held))
        return states[-1], jax.vmap(self.patient.glucose_mg_dl)(states)

    def _between(
        self, x: jax.Array, insulin_mU_min: jax.Array, start: jax.Array, after_min: jax.Array, held: Held
    ) -> jax.Array:
        """States at times after a start, under inputs that are held from there to the last of them."""
        patient, end = held.of(self.patient), start + after_min[-1]

        def rates(t: Any, x: jax.Array, _: Any) -> jax.Array:
            meal = appearance_mg_min(t, self.absorption)
            return patient.derivative(self.clock_min + t, x, held.inputs(insulin_mU_min, meal))

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            diffrax.Dopri8(),
            start,
            end,
            after_min[-1] / 50.0,
            x,
            saveat=diffrax.SaveAt(ts=start + after_min),
            stepsize_controller=self._steps(start, end),
            max_steps=None,
        )
        states: jax.Array | None = solution.ys
        assert states is not None
        return states

    def _steps(self, start: jax.Array, end: jax.Array) -> Any:
        """Adaptive steps between two times, none of them across a jump of a meal."""
        adaptive = diffrax.PIDController(rtol=self.tolerance, atol=self.tolerance)
        jumps = self.absorption.jumps.t_min
        if jumps.size == 0:
            return adaptive
        # outside the sample a jump is of no concern: sorted, each lies at its place or at the end
        inside = jnp.sort(jnp.where((jumps > start) & (jumps < end), jumps, end))
        return diffrax.ClipStepSizeController(adaptive, jump_ts=inside)


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

    def prepare(self, patient: Patient, absorption: Absorption, grid: SampleGrid) -> tuple[AdaptivePlant, Exogenous]:
        """The patient and the meals that it absorbs, and the time at which each sample begins."""
        plant = AdaptivePlant(
            patient=patient,
            absorption=absorption,
            inside_min=jnp.asarray(grid.inside_min),
            clock_min=grid.start_min,
            tolerance=self.tolerance,
        )
        return plant, Exogenous(t_min=jnp.asarray(grid.t_min))

    def at_sample(
        self, plant: AdaptivePlant, absorption: Absorption, grid: SampleGrid, index: jax.Array
    ) -> tuple[AdaptivePlant, Exogenous]:
        """The plant with these meals, and the time at which the sample with a number begins."""
        return dataclasses.replace(plant, absorption=absorption), Exogenous(t_min=index * grid.sample_time_min)
