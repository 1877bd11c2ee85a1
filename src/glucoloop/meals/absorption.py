"""The appearance of glucose from meals, in closed form or exact to rounding, for any meal model."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

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
    """Combine meals with the meal model that absorbs them.

    Parameters
    ----------
    model : MealModel
        Meal model of one person, or of people; in that case the meals have a trailing axis of people too.
    eaten : Eaten
    """
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
    absorption : Absorption

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
