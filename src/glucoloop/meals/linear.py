"""The appearance of glucose from meals, in closed form or exact to rounding, for any linear meal model.

`appearance_moments` sums over all jumps, at one step. A run takes each jump once, at the step in which it lies, and
integrates the state of the meal model from step to step, so that time and memory are in proportion to its length.
`linear_digestion` does so for people with individual meals and guts, sample by sample of their loop.
"""

from __future__ import annotations

import functools
import math
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._disk_cache import kept_result
from glucoloop._kept_programs import kept_jit
from glucoloop._pytree import pytree, static
from glucoloop.arguments import is_traced
from glucoloop.meals.moments import MOMENTS, NODES, WEIGHTS, legendre
from glucoloop.meals.protocol import Eaten, Jumps, LinearMealModel

NEVER_MIN: Final = 1e12
"""Time of a jump that is in no sample."""


@pytree
class LinearAbsorption:
    """Meals together with a linear gut; implements `Absorption`."""

    model: LinearMealModel
    jumps: Jumps
    state: jax.Array
    """(states, ...) state before the coming sample; at the time 0, that of the jumps before it."""

    def goes_on(self, state: jax.Array) -> LinearAbsorption:
        """The same meals with the gut in another state, that before the coming sample."""
        return LinearAbsorption(model=self.model, jumps=self.jumps, state=state)

    def moments(self, samples: int, substeps: int, step_min: float) -> jax.Array:
        """Exact moments of the appearance over every step of a run, ``(samples, substeps, 3, ...)``."""
        moments: jax.Array = kept_result(_moments_of_run, self, samples, substeps, step_min)
        return moments

    def at_sample(self, index: jax.Array, substeps: int, step_min: float) -> tuple[jax.Array, jax.Array]:
        """The same of the coming sample, which has the number `index`, and the state of the gut after it."""
        after, moments, _ = _digested(self, index * substeps, substeps, step_min)
        return moments, after

    def emptying_mg_min(self, samples: int, sample_time_min: float) -> jax.Array:
        """Rate at which the stomach empties at every sample of a run, ``(samples, ...)``."""
        # one sample after the other: a table of samples by jumps would grow with the square of the run's length
        emptying: jax.Array = jax.lax.map(lambda t: emptying_mg_min(t, self), jnp.arange(samples) * sample_time_min)
        return emptying


@kept_jit
def absorb_linearly(model: LinearMealModel, eaten: Eaten) -> LinearAbsorption:
    """Combine meals with the linear model that absorbs them."""
    jumps = model.jumps(eaten)
    earlier = _answers(model, jumps, jnp.zeros(()), jumps.t_min < 0.0)
    return LinearAbsorption(model=model, jumps=jumps, state=earlier)


def _state_at(t_min: jax.Array, absorption: LinearAbsorption) -> jax.Array:
    """State of the meal model ``(states, ...)`` at a time, a scalar or `(...)`; after a jump at that moment."""
    return _answers(absorption.model, absorption.jumps, t_min, absorption.jumps.t_min <= t_min)


def _answers(model: LinearMealModel, jumps: Jumps, t_min: jax.Array, counts: jax.Array) -> jax.Array:
    """State of a meal model at a time, the sum of its answers to those jumps before it that count."""
    answers = model.propagator(jnp.maximum(t_min - jumps.t_min, 0.0))[:, -jumps.size.shape[0] :]
    return jnp.sum(jnp.where(counts, jumps.size * answers, 0.0), axis=(1, 2))


@pytree
class SampleMeals:
    """Meals as a linear gut meets them in one sample: its state before it, and the jumps inside it.

    What was eaten before is in the state, so that the appearance at a moment takes no longer after days of meals.
    """

    start_min: jax.Array
    """Start of the sample."""
    state: jax.Array
    """(states, ...) state before the sample."""
    jumps: Jumps
    """Jumps of the sample; those of no size are at `NEVER_MIN`."""

    def appearance_mg_min(self, t_min: jax.Array, model: LinearMealModel) -> jax.Array:
        """Rate at which glucose from meals appears in the blood, at a time in the sample."""
        of_state = jnp.sum(model.propagator(t_min - self.start_min)[0] * self.state, axis=0)
        return of_state + _answers(model, self.jumps, t_min, self.jumps.t_min <= t_min)[0]


def meals_of_samples(absorption: LinearAbsorption, samples: int, sample_time_min: float) -> SampleMeals:
    """Meals of every sample of a run, with an axis of samples before all others.

    Each jump is taken once, in the sample in which it lies; a transformation by JAX looks at all of them in each.
    """
    states, jumps = _states_of_run(absorption, samples, sample_time_min), absorption.jumps
    start_min = sample_time_min * jnp.arange(samples)
    if is_traced(jumps):
        return jax.vmap(lambda k, state: _in_sample(absorption, k, state, sample_time_min))(jnp.arange(samples), states)
    t_min, size = np.asarray(jumps.t_min), np.asarray(jumps.size)
    people = t_min.shape[1:]
    t_min, size = t_min.reshape(-1, math.prod(people)), size.reshape(size.shape[0], -1, math.prod(people))
    number = np.floor(t_min / sample_time_min).astype(int)
    jump, person = np.nonzero((number >= 0) & (number < samples))
    sample = number[jump, person]
    order = np.lexsort((jump, person, sample))
    sample, jump, person = sample[order], jump[order], person[order]
    first = np.append(True, (np.diff(sample) != 0) | (np.diff(person) != 0))[: sample.size]
    place = np.arange(sample.size) - np.maximum.accumulate(np.where(first, np.arange(sample.size), 0))
    most = int(place.max(initial=-1)) + 1
    times = np.full((samples, most, t_min.shape[1]), NEVER_MIN)
    sizes = np.zeros((samples, size.shape[0], most, t_min.shape[1]))
    times[sample, place, person] = t_min[jump, person]
    sizes[sample, :, place, person] = size[:, jump, person].T
    return SampleMeals(
        start_min=start_min,
        state=states,
        jumps=Jumps(
            t_min=jnp.asarray(times.reshape(samples, most, *people)),
            size=jnp.asarray(sizes.reshape(samples, size.shape[0], most, *people)),
        ),
    )


def meals_of_sample(absorption: LinearAbsorption, index: jax.Array, sample_time_min: float) -> SampleMeals:
    """Meals of the coming sample, which has the number `index`."""
    return _in_sample(absorption, index, absorption.state, sample_time_min)


def _in_sample(absorption: LinearAbsorption, index: jax.Array, state: jax.Array, sample_time_min: float) -> SampleMeals:
    jumps = absorption.jumps
    inside = jnp.floor(jumps.t_min / sample_time_min).astype(int) == index
    return SampleMeals(
        start_min=index * sample_time_min,
        state=state,
        jumps=Jumps(t_min=jnp.where(inside, jumps.t_min, NEVER_MIN), size=jnp.where(inside, jumps.size, 0.0)),
    )


def appearance_mg_min(t_min: jax.Array, absorption: LinearAbsorption) -> jax.Array:
    """Rate at which glucose from meals appears in the blood, at a time, a scalar or `(...)`."""
    return _state_at(t_min, absorption)[0]


def emptying_mg_min(t_min: jax.Array, absorption: LinearAbsorption) -> jax.Array:
    """Rate at which the stomach empties; the rate of eating where a model has no stomach."""
    state = _state_at(t_min, absorption)
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
    return moments_of_jumps(absorption.model, absorption.jumps, t_min, step_min)


def moments_of_jumps(model: LinearMealModel, jumps: Jumps, t_min: jax.Array, step_min: float) -> jax.Array:
    """Moments as `appearance_moments`, of a meal model and the jumps that reach it."""
    since = jumps.t_min - t_min
    begin = jnp.clip(since / step_min, 0.0, 1.0)
    total = jnp.zeros((3, *since.shape[1:]))
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        s = begin + (1.0 - begin) * node
        answers = model.propagator(jnp.maximum(s * step_min - since, 0.0))[0, -jumps.size.shape[0] :]
        rate = jnp.sum(jumps.size * answers, axis=0) * (weight * (1.0 - begin))
        x = 2.0 * s - 1.0
        total = total + jnp.sum(jnp.stack([rate, rate * x, rate * (1.5 * x * x - 0.5)]), axis=1)
    return total


@pytree
class _LinearDigestion:
    """Matrices of a step without jumps, computed once per gut and step length, people trailing; a `Digestion`."""

    of_moments: jax.Array
    """(3, states, ...) Legendre moments of the appearance over the step, from the state at its start."""
    transition: jax.Array
    """(states, states, ...) transition to the state at the end of the step."""
    substeps: int = static()

    @property
    def inputs(self) -> tuple[int, int]:
        """Shape of what reaches a person's gut in a sample: see `absorption.JumpsInSteps`."""
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


@kept_jit(static_argnums=(1, 2))
def linear_digestion(model: LinearMealModel, substeps: int, step_min: float) -> _LinearDigestion:
    """Compute the matrices of a step of a meal model."""
    weights = legendre(NODES).T * WEIGHTS
    path = jnp.stack([model.propagator(jnp.asarray(step_min * node))[0] for node in NODES])
    return _LinearDigestion(
        of_moments=jnp.tensordot(jnp.asarray(weights), path, 1),
        transition=model.propagator(jnp.asarray(step_min)),
        substeps=substeps,
    )


@functools.partial(jax.jit, static_argnames=("samples", "substeps", "step_min"))
def _moments_of_run(absorption: LinearAbsorption, samples: int, substeps: int, step_min: float) -> jax.Array:
    moments = _digested(absorption, 0, samples * substeps, step_min)[1]
    return moments.reshape(samples, substeps, *moments.shape[1:])


@functools.partial(jax.jit, static_argnames=("samples", "sample_time_min"))
def _states_of_run(absorption: LinearAbsorption, samples: int, sample_time_min: float) -> jax.Array:
    return _digested(absorption, 0, samples, sample_time_min)[2]


def _digested(
    absorption: LinearAbsorption, first: jax.Array | int, steps: int, step_min: float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """State of the gut after steps of which the first has a number, and moments and states of each.

    The moments ``(steps, 3, ...)`` are over the steps, and the states ``(steps, states, ...)`` before them.
    """
    model, jumps, people = absorption.model, absorption.jumps, absorption.jumps.t_min.shape[1:]
    digestion, states, width = linear_digestion(model, 1, step_min), absorption.state.shape[0], math.prod(people)
    number = jnp.floor(jumps.t_min / step_min).astype(int)
    added = added_by_jump(model, jumps.t_min - number * step_min, jumps.size, step_min)

    # people, if there are any, have one axis here; where they have the same gut, its matrices have none
    place = (number - first).reshape(-1, width)
    place = jnp.where(place < 0, steps, place)  # which is dropped, while a negative place counts from the end
    added = jnp.moveaxis(added.reshape(MOMENTS + states, -1, width), 0, -1)
    table = jnp.zeros((steps, MOMENTS + states, width)).at[place, :, jnp.arange(width)].add(added, mode="drop")
    of_moments, transition = (
        matrix.reshape(*matrix.shape[:2], -1) for matrix in (digestion.of_moments, digestion.transition)
    )

    def step(state: jax.Array, inside: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        moments = jnp.sum(of_moments * state, axis=1) + inside[:MOMENTS]
        return jnp.sum(transition * state, axis=1) + inside[MOMENTS:], (moments, state)

    after, (moments, before) = jax.lax.scan(step, absorption.state.reshape(states, width), table)
    return (
        after.reshape(states, *people),
        moments.reshape(steps, MOMENTS, *people),
        before.reshape(steps, states, *people),
    )


def added_by_jump(model: LinearMealModel, since_min: jax.Array, size: jax.Array, step_min: float) -> jax.Array:
    """Moments of the step in which jumps ``(...)`` lie, and the states at its end, ``(3 + states, ...)``.

    The jumps, of sizes ``(inputs, ...)``, come some time after the step begins.
    """
    alone = Jumps(t_min=since_min[None], size=size[:, None])
    moments = moments_of_jumps(model, alone, jnp.zeros(()), step_min)
    answers = model.propagator(step_min - since_min)[:, -size.shape[0] :]
    return jnp.concatenate([moments, jnp.sum(size * answers, axis=1)])
