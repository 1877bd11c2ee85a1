"""The appearance of glucose from meals, in closed form or exact to rounding, for any linear meal model.

`appearance_moments` sums over all jumps at every step. For many people with individual meals and guts,
`LinearDigestion` takes each jump once, at the step in which it lies, and carries the state of the meal model from step
to step; `carried_moments` does the same for a whole run of people who eat the same.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._disk_cache import kept_result
from glucoloop._pytree import pytree, static
from glucoloop.meals.moments import MOMENTS, NODES, WEIGHTS, legendre
from glucoloop.meals.protocol import Eaten, Jumps, LinearMealModel


@pytree
class LinearAbsorption:
    """Meals together with a linear gut; implements `Absorption`."""

    model: LinearMealModel
    jumps: Jumps

    @property
    def state(self) -> None:
        """State that is carried, which is None: the closed forms take all meals since the start."""

    def goes_on(self, state: None) -> LinearAbsorption:
        """The same, whatever has been digested."""
        del state
        return self

    def moments(self, samples: int, substeps: int, step_min: float) -> jax.Array:
        """Exact moments of the appearance over every step of a run, ``(samples, substeps, 3, ...)``."""
        starts = np.arange(samples * substeps).reshape(samples, substeps) * step_min
        moments: jax.Array = kept_result(_moments, starts, step_min, self)
        return moments

    def at_sample(self, index: jax.Array, substeps: int, step_min: float) -> tuple[jax.Array, None]:
        """The same for the steps of the sample with a number, ``(substeps, 3, ...)``."""
        starts = (index * substeps + jnp.arange(substeps)) * step_min
        moments: jax.Array = _moments(starts[None], step_min, self)[0]
        return moments, None

    def emptying_mg_min(self, samples: int, sample_time_min: float) -> jax.Array:
        """Rate at which the stomach empties at every sample of a run, ``(samples, ...)``."""
        return jax.vmap(lambda t: emptying_mg_min(t, self))(jnp.arange(samples) * sample_time_min)


@jax.jit
def _jumps(model: LinearMealModel, eaten: Eaten) -> Jumps:
    return model.jumps(eaten)


def absorb_linearly(model: LinearMealModel, eaten: Eaten) -> LinearAbsorption:
    """Combine meals with the linear model that absorbs them."""
    return LinearAbsorption(model=model, jumps=_jumps(model, eaten))


def state_at(t_min: jax.Array, absorption: LinearAbsorption) -> jax.Array:
    """State of the meal model ``(states, ...)`` at a time, a scalar or `(...)`; after a jump at that moment."""
    jumps = absorption.jumps
    since = t_min - jumps.t_min
    answers = absorption.model.propagator(jnp.maximum(since, 0.0))[:, -jumps.size.shape[0] :]
    return jnp.sum(jnp.where(since >= 0.0, jumps.size * answers, 0.0), axis=(1, 2))


def appearance_mg_min(t_min: jax.Array, absorption: LinearAbsorption) -> jax.Array:
    """Rate at which glucose from meals appears in the blood, at a time, a scalar or `(...)`."""
    return state_at(t_min, absorption)[0]


def emptying_mg_min(t_min: jax.Array, absorption: LinearAbsorption) -> jax.Array:
    """Rate at which the stomach empties; the rate of eating where a model has no stomach."""
    state = state_at(t_min, absorption)
    return state[min(1, state.shape[0] - 1)]


def appearance_moments(t_min: jax.Array, step_min: float, absorption: LinearAbsorption) -> jax.Array:
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


@jax.jit
def _moments(starts_min: jax.Array, step_min: float, absorption: LinearAbsorption) -> jax.Array:
    return jax.vmap(jax.vmap(lambda t: appearance_moments(t, step_min, absorption)))(starts_min)


@pytree
class LinearDigestion:
    """Matrices of a step without jumps, computed once per gut and step length, people trailing; a `Digestion`."""

    of_moments: jax.Array
    """(3, states, ...) Legendre moments of the appearance over the step, from the state at its start."""
    transition: jax.Array
    """(states, states, ...) transition to the state at the end of the step."""
    substeps: int = static()

    @property
    def inputs(self) -> tuple[int, int]:
        """Shape of what reaches a person's gut in a sample: see `meals.jumps`."""
        return self.substeps, MOMENTS + self.transition.shape[0]

    def init(self) -> jax.Array:
        """State of one person who has eaten nothing."""
        return jnp.zeros(self.transition.shape[0])

    def sample(self, state: jax.Array, inputs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Digestion of one person over one sample: the state at its end, and the moments ``(substeps, 3)``."""
        moments = []
        for inside in inputs:
            moments.append(self.of_moments @ state + inside[:MOMENTS])
            state = self.transition @ state + inside[MOMENTS:]
        return state, jnp.stack(moments)


@functools.partial(jax.jit, static_argnames=("substeps", "step_min"))
def linear_digestion(model: LinearMealModel, substeps: int, step_min: float) -> LinearDigestion:
    """Compute the matrices of a step of a meal model."""
    weights = legendre(NODES).T * WEIGHTS
    path = jnp.stack([model.propagator(jnp.asarray(step_min * node))[0] for node in NODES])
    return LinearDigestion(
        of_moments=jnp.tensordot(jnp.asarray(weights), path, 1),
        transition=model.propagator(jnp.asarray(step_min)),
        substeps=substeps,
    )


def carried_moments(absorption: LinearAbsorption, samples: int, substeps: int, step_min: float) -> jax.Array:
    """Moments ``(samples, substeps, 3, people)`` as `LinearAbsorption.moments`, with each jump taken once.

    The absorption is of people and has jumps ``(jumps, people)`` from the time 0 on. JAX traces and differentiates it.
    """
    digestion = linear_digestion(absorption.model, substeps, step_min)
    number, added = _of_jumps(absorption, step_min)
    entries, _, people = added.shape
    table = jnp.zeros((samples * substeps, entries, people))
    table = table.at[number, :, jnp.arange(people)].add(jnp.moveaxis(added, 0, -1), mode="drop")

    # where people have the same gut, its matrices have no axis of people
    of_moments, transition = (
        matrix.reshape(*matrix.shape[:2], -1) for matrix in (digestion.of_moments, digestion.transition)
    )

    def step(state: jax.Array, inside: jax.Array) -> tuple[jax.Array, jax.Array]:
        moments = jnp.sum(of_moments * state, axis=1) + inside[:MOMENTS]
        return jnp.sum(transition * state, axis=1) + inside[MOMENTS:], moments

    start = jnp.zeros((entries - MOMENTS, people))
    _, moments = jax.lax.scan(step, start, table)
    return moments.reshape(samples, substeps, MOMENTS, people)


@functools.partial(jax.jit, static_argnames="step_min")
def _of_jumps(absorption: LinearAbsorption, step_min: float) -> tuple[jax.Array, jax.Array]:
    """Step of each jump ``(jumps, people)``, and the contribution of the jump ``(3 + states, jumps, people)``."""
    jumps = absorption.jumps
    number = jnp.floor(jumps.t_min / step_min).astype(int)
    return number, added_by_jump(absorption.model, jumps.t_min - number * step_min, jumps.size, step_min)


def added_by_jump(model: LinearMealModel, since_min: jax.Array, size: jax.Array, step_min: float) -> jax.Array:
    """Moments of the step in which jumps ``(...)`` lie, and the states at its end, ``(3 + states, ...)``.

    The jumps, of sizes ``(inputs, ...)``, come some time after the step begins.
    """
    alone = LinearAbsorption(model=model, jumps=Jumps(t_min=since_min[None], size=size[:, None]))
    moments = appearance_moments(jnp.zeros(()), step_min, alone)
    answers = model.propagator(step_min - since_min)[:, -size.shape[0] :]
    return jnp.concatenate([moments, jnp.sum(size * answers, axis=1)])
