"""Meals of many people with individual meals and guts, as the moments that the exponential integrator takes.

`appearance_moments` sums over all jumps at every step; here each jump is taken once, at the step in which it lies, and
the state of the meal model is carried from step to step.
"""

from __future__ import annotations

import functools
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop.meals.absorption import NODES, WEIGHTS, Absorption, appearance_moments
from glucoloop.meals.protocol import Jumps, MealModel

MOMENTS: Final = 3


@pytree
class DigestionMatrices:
    """Matrices of a step without jumps, computed once per gut and step length; people trail."""

    moments: jax.Array
    """(3, states, ...) Legendre moments of the appearance over the step, from the state at its start."""
    transition: jax.Array
    """(states, states, ...) transition to the state at the end of the step."""


@functools.partial(jax.jit, static_argnames="step_min")
def digestion_matrices(model: MealModel, step_min: float) -> DigestionMatrices:
    """Compute the matrices of a step of a meal model."""
    x = 2.0 * NODES - 1.0
    legendre = np.stack([np.ones_like(x), x, 1.5 * x * x - 0.5]) * WEIGHTS
    path = jnp.stack([model.propagator(jnp.asarray(step_min * node))[0] for node in NODES])
    return DigestionMatrices(
        moments=jnp.tensordot(jnp.asarray(legendre), path, 1), transition=model.propagator(jnp.asarray(step_min))
    )


def digest(state: jax.Array, matrices: DigestionMatrices, inside: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Digestion of one person over one step: the state at its end, and moments ``(3,)`` as of `appearance_moments`.

    `inside` ``(3 + states,)`` is the contribution of the jumps within the step; see `jump_table`.
    """
    return matrices.transition @ state + inside[MOMENTS:], matrices.moments @ state + inside[:MOMENTS]


def jump_table(absorption: Absorption, *, steps: int, step_min: float) -> npt.NDArray[np.float64]:
    """Contributions ``(steps, 3 + states, people)`` of the jumps to the moments of each step and the state at its end.

    The absorption has jumps ``(jumps, people)``; those after the last step are ignored.
    """
    number, added = (np.asarray(part) for part in _of_jumps(absorption, step_min))
    people = np.arange(number.shape[1])
    table = np.zeros((steps, added.shape[0], people.size))
    for step, of_jump in zip(number, added.transpose(1, 0, 2), strict=True):
        # one jump of each person at a time, so that no place is named twice
        kept = (step >= 0) & (step < steps)
        for entry, values in enumerate(of_jump):
            table[step[kept], entry, people[kept]] += values[kept]
    return table


@functools.partial(jax.jit, static_argnames="step_min")
def _of_jumps(absorption: Absorption, step_min: float) -> tuple[jax.Array, jax.Array]:
    """Step of each jump ``(jumps, people)``, and the contribution of the jump ``(3 + states, jumps, people)``."""
    model, jumps = absorption.model, absorption.jumps
    number = jnp.floor(jumps.t_min / step_min).astype(int)
    since = jumps.t_min - number * step_min
    alone = Absorption(model=model, jumps=Jumps(t_min=since[None], size=jumps.size[:, None]))
    moments = appearance_moments(jnp.zeros(()), step_min, alone)
    answers = model.propagator(step_min - since)[:, -jumps.size.shape[0] :]
    return number, jnp.concatenate([moments, jnp.sum(jumps.size * answers, axis=1)])
