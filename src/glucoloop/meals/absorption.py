"""The appearance of glucose from meals, in closed form or exact to rounding, for any meal model.

`appearance_moments` sums over all jumps at every step. For many people with individual meals and guts, `digest` takes
each jump once, at the step in which it lies, and carries the state of the meal model from step to step.
"""

from __future__ import annotations

import functools
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop.meals.protocol import Eaten, Jumps, MealModel

# Nodes and weights on [0, 1]. The appearance is smooth between jumps, on the scale of the model's time constants: eight
# are exact to rounding over up to three of them.
_GAUSS = np.polynomial.legendre.leggauss(8)
NODES, WEIGHTS = (_GAUSS[0] + 1.0) / 2.0, _GAUSS[1] / 2.0


@pytree
class Absorption:
    """Meals together with the gut that absorbs them."""

    model: MealModel
    jumps: Jumps


@jax.jit
def _jumps(model: MealModel, eaten: Eaten) -> Jumps:
    return model.jumps(eaten)


def absorb(model: MealModel, eaten: Eaten) -> Absorption:
    """Combine meals with the meal model that absorbs them; with a model of people, meals have an axis of people too."""
    return Absorption(model=model, jumps=_jumps(model, eaten))


def fasting(model: MealModel) -> Absorption:
    """Absorption without any meal."""
    none = jnp.zeros(0)
    return absorb(model, Eaten(t_min=none, carbs_g=none, eating_min=none))


def state_at(t_min: jax.Array, absorption: Absorption) -> jax.Array:
    """State of the meal model ``(states, ...)`` at a time, a scalar or `(...)`; after a jump at that moment."""
    jumps = absorption.jumps
    since = t_min - jumps.t_min
    answers = absorption.model.propagator(jnp.maximum(since, 0.0))[:, -jumps.size.shape[0] :]
    return jnp.sum(jnp.where(since >= 0.0, jumps.size * answers, 0.0), axis=(1, 2))


def appearance_mg_min(t_min: jax.Array, absorption: Absorption) -> jax.Array:
    """Rate at which glucose from meals appears in the blood, at a time, a scalar or `(...)`."""
    return state_at(t_min, absorption)[0]


def emptying_mg_min(t_min: jax.Array, absorption: Absorption) -> jax.Array:
    """Rate at which the stomach empties; the rate of eating where a model has no stomach."""
    state = state_at(t_min, absorption)
    return state[min(1, state.shape[0] - 1)]


def appearance_moments(t_min: jax.Array, step_min: float, absorption: Absorption) -> jax.Array:
    """Exact Legendre moments of the appearance over one step.

    Parameters
    ----------
    t_min : scalar
        Start of the step.
    step_min : float
        Length h of the step.

    Returns
    -------
    (3, ...) array
        ``integral of appearance(t + h s) P_n(2 s - 1) ds over 0 <= s <= 1`` for n = 0, 1, 2 in mg/min, with the
        jumps inside the step honoured: the answer to each is integrated from the moment at which it begins.
    """
    jumps = absorption.jumps
    since = jumps.t_min - t_min
    begin = jnp.clip(since / step_min, 0.0, 1.0)
    total = jnp.zeros((3, *since.shape[1:]))
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        s = begin + (1.0 - begin) * node
        answers = absorption.model.propagator(jnp.maximum(s * step_min - since, 0.0))[0, -jumps.size.shape[0] :]
        rate = jnp.sum(jumps.size * answers, axis=0) * (weight * (1.0 - begin))
        x = 2.0 * s - 1.0
        total = total + jnp.sum(jnp.stack([rate, rate * x, rate * (1.5 * x * x - 0.5)]), axis=1)
    return total


MOMENTS: Final = 3
# Legendre polynomials P_0, P_1, P_2 times 2 n + 1, at the start, the middle and the end of a step.
_FROM_MOMENTS: Final = np.array([[1.0, -3.0, 5.0], [1.0, 0.0, -2.5], [1.0, 3.0, 5.0]])


def at_start_middle_end(moments: jax.Array) -> jax.Array:
    """Values ``(3, ...)`` at the start, the middle and the end of a step of the quadratic that has given moments."""
    return jnp.tensordot(jnp.asarray(_FROM_MOMENTS, moments.dtype), moments, 1)


def moments_of_parts(moments: jax.Array, parts: int) -> jax.Array:
    """Moments ``(parts, 3, ...)`` of equal parts of a step, from those ``(3, ...)`` of the quadratic over all of it."""
    start = np.arange(parts)[:, None] / parts
    of_whole = _legendre(start + NODES / parts) * np.array([1.0, 3.0, 5.0])
    matrix = np.einsum("pnk,nj,n->pjk", of_whole, _legendre(NODES), WEIGHTS)
    return jnp.tensordot(jnp.asarray(matrix, moments.dtype), moments, 1)


def _legendre(s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """P_0, P_1 and P_2 of 2 s - 1, on the last axis."""
    x = 2.0 * s - 1.0
    return np.stack([np.ones_like(x), x, 1.5 * x * x - 0.5], axis=-1)


def meal_moments(samples: int, substeps: int, step_min: float, absorption: Absorption) -> jax.Array:
    """Moments of the meals' appearance over every step, ``(samples, substeps, 3, ...)``."""
    starts = jnp.arange(samples * substeps).reshape(samples, substeps) * step_min
    moments: jax.Array = _moments(starts, step_min, absorption)
    return moments


def moments_of_sample(index: jax.Array, substeps: int, step_min: float, absorption: Absorption) -> jax.Array:
    """The same for the steps of the sample with a number, ``(substeps, 3, ...)``."""
    starts = (index * substeps + jnp.arange(substeps)) * step_min
    moments: jax.Array = _moments(starts[None], step_min, absorption)[0]
    return moments


@jax.jit
def _moments(starts_min: jax.Array, step_min: float, absorption: Absorption) -> jax.Array:
    return jax.vmap(jax.vmap(lambda t: appearance_moments(t, step_min, absorption)))(starts_min)


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
    legendre = _legendre(NODES).T * WEIGHTS
    path = jnp.stack([model.propagator(jnp.asarray(step_min * node))[0] for node in NODES])
    return DigestionMatrices(
        moments=jnp.tensordot(jnp.asarray(legendre), path, 1), transition=model.propagator(jnp.asarray(step_min))
    )


def digest(state: jax.Array, matrices: DigestionMatrices, inside: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Digestion of one person over one step: the state at its end, and moments ``(3,)`` as of `appearance_moments`.

    `inside` ``(3 + states,)`` is the contribution of the jumps within the step; see `jump_table`.
    """
    return matrices.transition @ state + inside[MOMENTS:], matrices.moments @ state + inside[:MOMENTS]


def jump_table(
    absorption: Absorption, *, steps: int, step_min: float, first: int | None = None
) -> npt.NDArray[np.float64]:
    """Contributions ``(steps, 3 + states, people)`` of the jumps to the moments of each step and the state at its end.

    The absorption has jumps ``(jumps, people)``; those after the last step are ignored. With `first` the steps are
    those from the one of that number on, and only jumps that lie in them are looked at.
    """
    if first is not None:
        t_min = np.asarray(absorption.jumps.t_min)
        begin, end = step_min * np.array([first - 1, first + steps + 1])
        near = ((t_min >= begin) & (t_min < end)).any(axis=1)
        absorption = jax.tree.map(jnp.asarray, absorption)
        jumps = Jumps(t_min=absorption.jumps.t_min[near], size=absorption.jumps.size[:, near])
        absorption = Absorption(model=absorption.model, jumps=jumps)
    number, added = (np.asarray(part) for part in _of_jumps(absorption, step_min))
    number = number - (first or 0)
    people = np.arange(number.shape[1])
    table = np.zeros((steps, added.shape[0], people.size))
    for step, of_jump in zip(number, added.transpose(1, 0, 2), strict=True):
        # one jump of each person at a time, so that no place is named twice
        within = (step >= 0) & (step < steps)
        for entry, values in enumerate(of_jump):
            table[step[within], entry, people[within]] += values[within]
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
