"""A gut given by its equations, advanced beside the body, and the moments of what appears.

The gut is advanced by a two-derivative Runge-Kutta method of Chan and Tsai (2010), of fifth order, by equal steps that
end with the points of the fine grid, where the rate of eating and what the gut remembers jump. With ``f = s'`` at the
start and ``g = s''``, which follows from the equations,

    s_2 = s + 3/10 h f + 9/200 h^2 g_1,    s_3 = s + 3/4 h f + 9/32 h^2 g_2
    s_end = s + h f + h^2/162 (15 g_1 + 50 g_2 + 16 g_3)

Three states are looked at in a step, where a classical method of this order takes six: what costs most, a hyperbolic
tangent, has its derivative for nothing. The appearance at the start, the middle and the end of a step makes the
quadratic whose moments the body takes. Steps of the body need not end with those of the gut.

References
----------
R. P. K. Chan, A. Y. J. Tsai, "On explicit two-derivative Runge-Kutta methods", Numer. Algorithms 53, 2010, 171-194.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree, static
from glucoloop.arguments import is_traced
from glucoloop.meals.moments import moments_of_steps, moments_of_values, points_of_sample
from glucoloop.meals.protocol import SHORTEST_EATING_MIN, Eaten, OdeMealModel
from glucoloop.sparse import Sparse
from glucoloop.units import MG_PER_G

STEPS_PER_POINT: Final = 4
"""Minimum number of steps of the gut in a point: some stomachs slow down within a minute."""
NOTHING: Final = 1e-20
"""Amount below which a state is set to zero, so that numbers never become subnormal, with which processors are slow."""


@pytree
class OdeDigestion:
    """A gut given by its equations, carried from sample to sample; implements `Digestion`."""

    model: OdeMealModel
    substeps: int = static()
    """Steps of the body in a sample."""
    sample_time_min: float = static()

    @property
    def points(self) -> int:
        """Points of the fine grid in a sample."""
        return points_of_sample(self.sample_time_min)

    @property
    def inputs(self) -> tuple[int, int]:
        """Shape of what reaches a person's gut in a sample: see `eaten_in_points`."""
        return self.points, 2

    def init(self) -> jax.Array:
        """State of somebody who has eaten nothing."""
        return self.model.init()

    def sample(self, state: jax.Array, inputs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Digestion over one sample: the state at its end, and the moments ``(substeps, 3, ...)``."""
        point_min = self.sample_time_min / self.points
        of_point = self.substeps // self.points if self.substeps % self.points == 0 else STEPS_PER_POINT

        def point(state: jax.Array, entry: jax.Array) -> tuple[jax.Array, jax.Array]:
            state = self.model.at_point(state, entry[0], entry[1] > 0.0)
            moments = []
            for _ in range(STEPS_PER_POINT):
                state, of_step = self._step(state, entry[0] / point_min, point_min / STEPS_PER_POINT)
                moments.append(of_step)
            flushed = jnp.where(jnp.abs(state) < NOTHING, 0.0, state)
            return flushed, moments_of_steps(jnp.stack(moments), of_point)

        state, moments = jax.lax.scan(point, state, inputs)
        return state, moments_of_steps(moments.reshape(-1, *moments.shape[2:]), self.substeps)

    def _step(self, state: jax.Array, eating_mg_min: jax.Array, h: float) -> tuple[jax.Array, jax.Array]:
        """State after a step, and the moments of the appearance over it."""
        f, g_1 = self._rates(state, eating_mg_min)
        _, g_2 = self._rates(state + 0.3 * h * f + 0.045 * h * h * g_1, eating_mg_min)
        _, g_3 = self._rates(state + 0.75 * h * f + 0.28125 * h * h * g_2, eating_mg_min)
        middle = state + h / 2.0 * f + h * h / 648.0 * (33.0 * g_1 + 50.0 * g_2 - 2.0 * g_3)
        end = state + h * f + h * h / 162.0 * (15.0 * g_1 + 50.0 * g_2 + 16.0 * g_3)
        return end, moments_of_values(*map(self.model.appearance_mg_min, (state, middle, end)))

    def _rates(self, state: jax.Array, eating_mg_min: jax.Array) -> tuple[jax.Array, jax.Array]:
        """First and second derivative of the state."""
        f = self.model.derivative(state, eating_mg_min)
        return jax.jvp(lambda state: self.model.derivative(state, eating_mg_min), (state,), (f,))


@pytree
class OdeAbsorption:
    """Meals together with a gut given by its equations; implements `Absorption`."""

    model: OdeMealModel
    eaten: Eaten
    state: jax.Array
    """(states, ...) state before the coming sample, which is the first one of a run."""

    def goes_on(self, state: jax.Array) -> OdeAbsorption:
        """The same meals with the gut in another state, that before the coming sample."""
        return OdeAbsorption(model=self.model, eaten=self.eaten, state=state)

    def moments(self, samples: int, substeps: int, step_min: float) -> jax.Array:
        """Moments of the appearance over every step of a run, ``(samples, substeps, 3, ...)``."""
        sample_time_min = substeps * step_min
        moments: jax.Array = _course(self, self.eaten_in_run(samples, sample_time_min), substeps, sample_time_min)[1]
        return moments

    def at_sample(self, index: jax.Array, substeps: int, step_min: float) -> tuple[jax.Array, jax.Array]:
        """The same of the coming sample, which has the number `index`, and the state of the gut after it."""
        digestion = OdeDigestion(model=self.model, substeps=substeps, sample_time_min=substeps * step_min)
        after, moments = digestion.sample(self.state, self.eaten_in_sample(index, digestion.sample_time_min))
        return moments, after

    def eaten_in_sample(self, index: jax.Array, sample_time_min: float) -> jax.Array:
        """Amounts that are eaten in the points of a sample, see `eaten_of`."""
        points = points_of_sample(sample_time_min)
        return eaten_of(self.eaten, index * points + jnp.arange(points), sample_time_min)

    def eaten_in_run(self, samples: int, sample_time_min: float) -> jax.Array:
        """The same of all samples of a run, ``(samples, points, 2, ...)``.

        Each meal is taken once, at the points in which it is eaten; a transformation by JAX looks at all meals in each
        sample.
        """
        if is_traced(self.eaten):
            each: jax.Array = jax.lax.map(lambda k: self.eaten_in_sample(k, sample_time_min), jnp.arange(samples))
            return each
        points, shape = points_of_sample(sample_time_min), self.eaten.carbs_g.shape
        flat = jax.tree.map(
            lambda part: np.broadcast_to(part, shape).reshape(shape[0], math.prod(shape[1:])), self.eaten
        )
        eaten = eaten_in_points(flat, samples * points, sample_time_min / points)
        return jnp.asarray(eaten.dense().reshape(samples, points, 2, *shape[1:]))

    def emptying_mg_min(self, samples: int, sample_time_min: float) -> jax.Array:
        """Rate at which the stomach empties at every sample of a run, ``(samples, ...)``."""
        states: jax.Array = _course(self, self.eaten_in_run(samples, sample_time_min), 1, sample_time_min)[0]
        return jax.vmap(self.model.emptying_mg_min)(states)


def absorb_by_equations(model: OdeMealModel, eaten: Eaten) -> OdeAbsorption:
    """Combine meals with the gut that absorbs them."""
    state, meals = model.init(), jax.tree.map(lambda part: jnp.asarray(part, float), eaten)
    people = jnp.broadcast_shapes(state.shape[1:], meals.carbs_g.shape[1:])
    spread = state.reshape(state.shape[0], *[1] * (len(people) + 1 - state.ndim), *state.shape[1:])
    return OdeAbsorption(model=model, eaten=meals, state=jnp.broadcast_to(spread, (state.shape[0], *people)))


@functools.partial(jax.jit, static_argnums=(2, 3))
def _course(absorption: OdeAbsorption, eaten: jax.Array, substeps: int, sample_time_min: float) -> Any:
    """State before every sample of a run, and the moments over its steps."""
    digestion = OdeDigestion(model=absorption.model, substeps=substeps, sample_time_min=sample_time_min)

    def one(state: jax.Array, points: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        after, moments = digestion.sample(state, points)
        return after, (state, moments)

    return jax.lax.scan(one, absorption.state, eaten)[1]


def eaten_of(eaten: Eaten, number: Any, sample_time_min: float) -> jax.Array:
    """Amounts eaten in points with given numbers [mg], and whether a meal begins there, ``(points, 2, ...)``.

    A meal of 0 g begins nowhere.
    """
    point_min = sample_time_min / points_of_sample(sample_time_min)
    begin, carbs_g = jnp.asarray(eaten.t_min, float), jnp.asarray(eaten.carbs_g, float)
    lasts = jnp.maximum(eaten.eating_min, SHORTEST_EATING_MIN)
    start = (number * point_min).reshape(-1, *[1] * carbs_g.ndim)
    eating_min = jnp.minimum(start + point_min, begin + lasts) - jnp.maximum(start, begin)
    eaten_mg = jnp.sum(jnp.maximum(eating_min, 0.0) * (MG_PER_G * carbs_g / lasts), axis=1)
    first = _point_of(begin, point_min, jnp)
    begins = jnp.any((first == number.reshape(start.shape)) & (carbs_g > 0.0), axis=1)
    return jnp.stack([eaten_mg, begins.astype(eaten_mg.dtype)], axis=1)


def eaten_in_points(eaten: Eaten, points: int, point_min: float, *, first: int = 0) -> Sparse:
    """The same of people with meals ``(meals, people)``, in points from a number on, ``(points, 2, people)``."""
    begin, carbs_g = np.asarray(eaten.t_min, float), np.asarray(eaten.carbs_g, float)
    lasts = np.maximum(np.asarray(eaten.eating_min, float), SHORTEST_EATING_MIN)
    rate, begins = MG_PER_G * carbs_g / lasts, _point_of(begin, point_min, np).astype(int)
    longest = math.ceil(np.max(lasts, initial=0.0) / point_min) + 1
    number = begins + np.arange(longest).reshape(-1, 1, 1)
    start, row = number * point_min, number - first
    minutes = np.minimum(start + point_min, begin + lasts) - np.maximum(start, begin)
    some = (minutes > 0.0) & (row >= 0) & (row < points)
    people, starting = begin.shape[1], (carbs_g > 0.0) & (begins >= first) & (begins < first + points)
    # two meals that begin in one point are one
    starts, person = np.divmod(np.unique((begins - first)[starting] * people + np.nonzero(starting)[1]), people)
    return Sparse(
        shape=(points, 2, people),
        row=np.concatenate([2 * row[some], 2 * starts + 1]),
        person=np.concatenate([np.nonzero(some)[-1], person]),
        number=np.concatenate([(minutes * rate)[some], np.ones(starts.size)]),
    )


def _point_of(begin_min: Any, point_min: float, xp: Any) -> Any:
    return xp.floor(begin_min / point_min + 1e-9)
