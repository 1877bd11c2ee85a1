"""Meals of many people, each with times and sizes of his own, as the moments that the exponential integrator takes.

`appearance_moments` sums over all kinks at every step; here each kink is taken once, at the step in which it lies, and
what went before is carried along: between kinks the emptying E is a straight line and the appearance r follows it,
``r' = (E - r) / T``.
"""

from __future__ import annotations

import functools
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop.meals.lehmann_deutsch import GUT_TIME_CONSTANT_MIN, Emptying, appearance_moments

ENTRIES: Final = 6
"""Numbers that a step is told of its kinks."""

_NODES, _WEIGHTS = (np.polynomial.legendre.leggauss(12)[0] + 1.0) / 2.0, np.polynomial.legendre.leggauss(12)[1] / 2.0
_T: Final = GUT_TIME_CONSTANT_MIN


@pytree
class Digestion:
    """What has been eaten, at the start of a step."""

    appearance_mg_min: jax.Array
    """r"""
    emptying_mg_min: jax.Array
    """E"""
    slope_mg_min2: jax.Array
    """E'"""


def fasting(like: jax.Array) -> Digestion:
    """Nothing has been eaten."""
    nothing = jnp.zeros_like(like)
    return Digestion(appearance_mg_min=nothing, emptying_mg_min=nothing, slope_mg_min2=nothing)


def digest(state: Digestion, kinks: jax.Array, step_min: float) -> tuple[Digestion, jax.Array]:
    """One step.

    Parameters
    ----------
    state : Digestion
    kinks : (6, ...) array
        What the kinks within the step add to the moments over it and to the state at its end; see `kink_table`.
    step_min : float
        Its length h.

    Returns
    -------
    state : Digestion
        At its end.
    moments : (3, ...) array
        Legendre moments of the appearance, as `appearance_moments` gives them, mg/min.
    """
    h = step_min
    s = _NODES
    legendre = np.stack([np.ones_like(s), 2.0 * s - 1.0, 6.0 * s * s - 6.0 * s + 1.0])
    of_decay = legendre * np.exp(-h * s / _T) @ _WEIGHTS
    r, E, slope = state.appearance_mg_min, state.emptying_mg_min, state.slope_mg_min2
    fading = r - E + slope * _T
    moments = jnp.stack(
        [
            E + slope * (h / 2.0 - _T) + fading * of_decay[0],
            slope * (h / 6.0) + fading * of_decay[1],
            fading * of_decay[2],
        ]
    )
    end = Digestion(
        appearance_mg_min=E + slope * (h - _T) + fading * float(np.exp(-h / _T)) + kinks[3],
        emptying_mg_min=E + slope * h + kinks[4],
        slope_mg_min2=slope + kinks[5],
    )
    return end, moments + kinks[:3]


def kink_table(
    kinks: Emptying, *, steps: int, step_min: float, table: npt.NDArray[np.float64] | None = None
) -> npt.NDArray[np.float64]:
    """What each step is told of the kinks within it.

    Parameters
    ----------
    kinks : Emptying
        ``(kinks, people)``; those after the last step are passed over.
    steps : int
    step_min : float
    table : (steps, 6, people) array, optional
        To be added to.

    Returns
    -------
    (steps, 6, people) array
        Added to the three moments over the step, and to r, E and E' at its end.
    """
    number, own = (np.asarray(part) for part in _of_kinks(kinks, step_min))
    people = np.arange(number.shape[1])
    table = np.zeros((steps, ENTRIES, people.size)) if table is None else table
    for step, of_kink in zip(number, own.transpose(1, 0, 2), strict=True):
        # one kink of each person at a time, so that no place is named twice
        kept = (step >= 0) & (step < steps)
        for entry in range(ENTRIES):
            table[step[kept], entry, people[kept]] += of_kink[entry, kept]
    return table


@functools.partial(jax.jit, static_argnames="step_min")
def _of_kinks(kinks: Emptying, step_min: float) -> tuple[jax.Array, jax.Array]:
    """The step of each kink ``(kinks, people)``, and what that step is told of it ``(6, kinks, people)``."""
    number = jnp.floor(kinks.t_min / step_min).astype(int)
    since = kinks.t_min - number * step_min
    slope, left = kinks.slope_change_mg_min2, step_min - since
    alone = Emptying(t_min=since[None], slope_change_mg_min2=slope[None])
    inside = appearance_moments(jnp.zeros(()), step_min, alone)
    ends = jnp.stack([slope * (left + _T * jnp.expm1(-left / _T)), slope * left, slope])
    return number, jnp.concatenate([inside, ends])
