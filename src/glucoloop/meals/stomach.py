"""Digestion sample by sample, for an observer to whom the size of a meal is unknown: Lehmann and Deutsch (1992).

`lehmann_deutsch` gives the rate of appearance of a meal whose beginning and size are known. Here the same meal is
described sample by sample. As long as a meal lasts it is *served*, and a meal of D mg lasts D / 360 min. The stomach
empties at 360 mg/min times the share of the last 30 min in which food was served: a ramp, a plateau and a ramp::

    E(t) = 360 s(t),    s(t) = mean of what was served over [t - 30, t],    q' = E - q / 60,    appearance = q / 60

So a meal is two events, its beginning and its end, and the second tells its size.

This is the trapezoid of `lehmann_deutsch` exactly where meals begin and end at samples. A beginning within a sample is
spread over it. A meal of less than 10.8 g, whose ramps are shorter there, empties more evenly here.
"""

from __future__ import annotations

import math
from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.meals.lehmann_deutsch import GUT_TIME_CONSTANT_MIN, PLATEAU_MG_MIN, RAMP_MIN
from glucoloop.units import MG_PER_G

SERVED_G_PER_MIN: Final = PLATEAU_MG_MIN / MG_PER_G


@pytree
class Stomach:
    """Carbohydrate that has been eaten and has not appeared yet; people trailing."""

    served: jax.Array
    """(n, ...) share of each of the last n samples, which make 30 min, in which a meal was served; the oldest first."""
    emptying_mg_min: jax.Array
    """(...) present rate of emptying E."""
    gut_mg: jax.Array
    """(...) present content of the gut q."""


def ramp_samples(sample_time_min: float) -> int:
    """Number of samples of a ramp of the emptying, at least one."""
    return max(1, round(RAMP_MIN / sample_time_min))


def empty_stomach(like: jax.Array, sample_time_min: float) -> Stomach:
    """Stomach and gut of a person who has eaten nothing."""
    nothing = jnp.zeros_like(like)
    return Stomach(
        served=jnp.zeros((ramp_samples(sample_time_min), *nothing.shape)), emptying_mg_min=nothing, gut_mg=nothing
    )


def digest(stomach: Stomach, served: jax.Array, sample_time_min: float) -> tuple[Stomach, jax.Array]:
    """Digestion over one sample.

    Parameters
    ----------
    stomach : Stomach
    served : (...) array
        Share of the sample in which a meal is served; more than 1 where meals overlap.
    sample_time_min : float

    Returns
    -------
    stomach : Stomach
        State at the end of the sample.
    appearance_mg_min : (3, ...) array
        Legendre moments of the rate of appearance, as `appearance_moments` gives them: those of the parabola through
        its beginning, middle and end.
    """
    h, T = sample_time_min, GUT_TIME_CONSTANT_MIN
    E = stomach.emptying_mg_min
    to = E + PLATEAU_MG_MIN / stomach.served.shape[0] * (served - stomach.served[0])
    slope = (to - E) / h
    fading = stomach.gut_mg - T * E + T * T * slope  # q = T (E + slope t) - T^2 slope + fading e^(-t/T)
    middle = T * (E + slope * h / 2.0) - T * T * slope + fading * math.exp(-h / 2.0 / T)
    end = T * to - T * T * slope + fading * math.exp(-h / T)
    a, b, c = stomach.gut_mg / T, middle / T, end / T
    moments = jnp.stack([(a + 4.0 * b + c) / 6.0, (c - a) / 6.0, (a + c - 2.0 * b) / 15.0])
    later = jnp.concatenate([stomach.served[1:], jnp.broadcast_to(served, E.shape)[None]])
    return Stomach(served=later, emptying_mg_min=to, gut_mg=end), moments


def steadily(appearance_mg_min: jax.Array) -> jax.Array:
    """Legendre moments ``(3, ...)`` of a rate of appearance that is held."""
    none = jnp.zeros_like(appearance_mg_min)
    return jnp.stack([appearance_mg_min, none, none])
