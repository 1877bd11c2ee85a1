"""Detection of oscillation: a loop oscillates if it changes direction more often than its meals explain.

After a meal glucose rises above the setpoint, falls below it, and may come from above once more: it crosses the band
about the setpoint twice. Insulin rises, falls, rises again where it fell too far, and falls back: it turns three times.
A loop that rings does so many more times, in one or in both.

A crossing goes from beyond 2 % of the setpoint on one side to beyond 2 % on the other, of glucose free of noise. A turn
is a change of the insulin's direction by more than a twentieth of the range of the run's doses, or by 0.5 mU/min if
that is more. A loop oscillates with more than 3 n - 1 crossings or more than 8 n - 1 turns, for n meals; none counts as
one. The bounds are ours, since the paper does not say how it saw oscillation: of its own tunings the liveliest turns 7
times, and tunings that turn 9 times ring visibly.

Noise turns the insulin of any controller, so oscillation is to be judged from a run without it.
"""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from glucoloop._pytree import pytree
from glucoloop.simulation import Trace

_BAND: Final = 0.02
"""Half width of the band, as a share of the setpoint."""
_TURN: Final = 0.05
"""Smallest change of direction that counts, as a share of the range of doses."""
_SMALLEST_TURN_MU_MIN: Final = 0.5
CROSSINGS_PER_MEAL: Final = 3
TURNS_PER_MEAL: Final = 8

_Extremes = tuple[jax.Array, jax.Array, jax.Array]


@pytree
class Oscillation:
    """Number of crossings of glucose and turns of insulin of one person."""

    crossings: jax.Array
    """Number of crossings of the band around the setpoint."""
    turns: jax.Array
    """Number of turns of insulin."""
    oscillates: jax.Array


def crossings(glucose_mg_dl: ArrayLike, setpoint_mg_dl: ArrayLike, band: float = _BAND) -> jax.Array:
    """Number of times that glucose crosses a band about the setpoint, whose half width is a share of it."""
    setpoint = jnp.asarray(setpoint_mg_dl)
    away = jnp.asarray(glucose_mg_dl) - setpoint
    sides = jnp.where(jnp.abs(away) > band * setpoint, jnp.sign(away), 0.0)

    def point(last: jax.Array, side: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jnp.where(side == 0.0, last, side), side * last < 0.0

    _, crossed = jax.lax.scan(point, jnp.zeros(()), sides)
    return crossed.sum()


def _turns(values: ArrayLike, least: ArrayLike) -> jax.Array:
    """Number of times that a series changes its direction by more than `least`; smaller changes do not count."""
    values = jnp.asarray(values, float)
    first = values[0]

    def point(carry: _Extremes, value: jax.Array) -> tuple[_Extremes, jax.Array]:
        direction, high, low = carry  # the extremes since the last turn
        high, low = jnp.maximum(high, value), jnp.minimum(low, value)
        down = (direction >= 0.0) & (high - value > least)
        up = ~down & (direction <= 0.0) & (value - low > least)
        new = jnp.where(down, -1.0, jnp.where(up, 1.0, direction))
        turned = new * direction < 0.0
        moved = down | up
        return (new, jnp.where(moved, value, high), jnp.where(moved, value, low)), turned

    _, turned = jax.lax.scan(point, (jnp.zeros(()), first, first), values)
    return turned.sum()


@jax.jit
def oscillation(trace: Trace) -> Oscillation:
    """Count the crossings and turns of a run of one person, and judge them by its meals."""
    insulin = jnp.concatenate([trace.basal_insulin_mU_min[None], trace.insulin_mU_min])
    least = jnp.maximum(_TURN * (insulin.max() - insulin.min()), _SMALLEST_TURN_MU_MIN)
    crossed = crossings(trace.fine_glucose_mg_dl, trace.setpoint_mg_dl)
    turned = _turns(insulin, least)
    meals = jnp.maximum((trace.carbs_g > 0.0).sum(), 1)
    return Oscillation(
        crossings=crossed,
        turns=turned,
        oscillates=(crossed > CROSSINGS_PER_MEAL * meals - 1) | (turned > TURNS_PER_MEAL * meals - 1),
    )
