"""Largest dose that a guard allows: in an hour, on board, and for the present reading.

Insulin on board is counted in basal rates beyond the basal rate: it is 1 after long at twice the basal rate.

Two caps are bounds that hold at every sample: insulin in an hour, and insulin on board. A pump can lower its rate only
by ``D`` per sample, so a rate may be allowed only if the caps still hold while the rate goes down from it to the basal
rate as fast as the pump can. Call a state safe if that is so for the rate in force. Then:

1. In a safe state the next rate on the way down is allowed, by the definition of safe.
2. Both caps grow with every rate, so every rate below an allowed one is allowed too, the basal rate included.
3. The guard gives at most the largest allowed rate, or the next one on the way down. Either leaves a safe state.

So from a safe state every later one is safe, for any readings and any controller, as long as the pump gives no more
than it was asked for. If it gives more, the guard takes the rate down as fast as the pump can until the caps hold.

A bolus counts as a rate of the sample in which it is given. It is allowed only if both caps hold with it on the whole
way down from the rate beside it, so that a state after it is safe too.

A rate below the basal rate counts as the basal rate in both caps. So insulin that was withheld is never given later,
and the way down never has to go below the basal rate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from glucoloop._pytree import pytree
from glucoloop.registry.guard import GuardSettings
from glucoloop.units import MIN_PER_H


@pytree
class Given:
    """Past insulin, and the doubt about the readings that led to it."""

    basal_mU_min: jax.Array
    per_basal: jax.Array
    """Inverse of the basal rate; 0 where that is 0."""
    on_board: jax.Array
    """Insulin on board, below 0 after a time below the basal rate."""
    counted: jax.Array
    """Insulin on board as the cap counts it, which never falls below 0."""
    hour_mU_min: jax.Array
    """(samples, ...) rates of the last hour but one sample, the oldest first, each at least the basal rate."""
    doubted_mg_dl: jax.Array
    """Part of the reading that is attributed to the sensor; below 0 after a jump down, which may be reversed."""


def samples_per_hour(sample_time_min: float) -> int:
    """Number of samples in an hour, at least 1."""
    return max(round(MIN_PER_H / sample_time_min), 1)


def first_given(basal_mU_min: jax.Array, sample_time_min: float) -> Given:
    """State after a long time at the basal rate."""
    zero = jnp.zeros_like(basal_mU_min)
    others = samples_per_hour(sample_time_min) - 1
    return Given(
        basal_mU_min=basal_mU_min,
        per_basal=_inverse(basal_mU_min),
        on_board=zero,
        counted=zero,
        hour_mU_min=jnp.broadcast_to(basal_mU_min, (others, *basal_mU_min.shape)),
        doubted_mg_dl=zero,
    )


def heal_given(given: Given, basal_mU_min: jax.Array, settings: GuardSettings, most_mU_min: jax.Array | float) -> Given:
    """Replace every impossible number of this state by the one that allows the least insulin.

    Parameters
    ----------
    given : Given
    basal_mU_min : (...) array
        Basal rate of the guard's construction, or NaN if it was built without one.
    settings : GuardSettings
    most_mU_min : float
        Highest possible rate.
    """

    def rate(value: jax.Array) -> jax.Array:
        return (value >= 0.0) & (value <= most_mU_min)

    # The basal rate is in the state twice. If the two disagree, the rate of the guard holds, or else the lower one.
    one, other = given.basal_mU_min, _inverse(given.per_basal)
    none = (one == 0.0) & (given.per_basal == 0.0)
    sound = rate(one) & ((jnp.abs(one * given.per_basal - 1.0) < _AGREE) | none)
    other = jnp.where(rate(other) & (other > _AGREE), other, most_mU_min)
    lower = jnp.where(rate(one), jnp.minimum(one, other), jnp.where(other < most_mU_min, other, 0.0))
    basal = jnp.where(sound, one, jnp.where(rate(basal_mU_min), basal_mU_min, lower))
    cap = settings.max_on_board
    return Given(
        basal_mU_min=basal,
        per_basal=jnp.where(sound, given.per_basal, _inverse(basal)),
        on_board=jnp.where(jnp.abs(given.on_board) < _ABSURD, given.on_board, cap),
        counted=jnp.where((given.counted >= 0.0) & (given.counted < _ABSURD), given.counted, cap),
        hour_mU_min=jnp.where(rate(given.hour_mU_min), given.hour_mU_min, settings.max_hour * basal),
        doubted_mg_dl=jnp.where(jnp.abs(given.doubted_mg_dl) < _ABSURD, given.doubted_mg_dl, _ABSURD),
    )


def take_in(
    given: Given,
    delivered_mU_min: jax.Array,
    above_setpoint_mg_dl: jax.Array,
    jump_mg_dl: jax.Array,
    settings: GuardSettings,
    sample_time_min: float,
) -> Given:
    """Include the rate of the last sample, and the jump that is attributed to the sensor.

    Parameters
    ----------
    given : Given
    delivered_mU_min : (...) array
        All insulin: the basal rate, and a bolus evenly over the sample.
    above_setpoint_mg_dl : (...) array
        Glucose less the setpoint.
    jump_mg_dl : (...) array
        Jump of the reading, 0 without one. Glucose does not jump: the jump is attributed to the sensor, as far as it
        would call for more insulin, and forgotten gradually.
    settings : GuardSettings
    sample_time_min : float
    """
    kept = _kept(settings, sample_time_min)
    beyond = (delivered_mU_min - given.basal_mU_min) * given.per_basal
    on_board = kept * given.on_board + (1.0 - kept) * beyond
    # How far glucose is above the setpoint, and how far insulin on board has lowered it.
    need = above_setpoint_mg_dl + settings.fall_mg_dl * on_board
    doubted = math.exp(-sample_time_min / settings.doubt_tau_min) * given.doubted_mg_dl + jump_mg_dl
    counted = jnp.maximum(delivered_mU_min, given.basal_mU_min)
    return Given(
        basal_mU_min=given.basal_mU_min,
        per_basal=given.per_basal,
        on_board=on_board,
        counted=jnp.maximum(kept * given.counted + (1.0 - kept) * beyond, 0.0),
        hour_mU_min=jnp.concatenate([given.hour_mU_min, counted[None]])[1:],
        doubted_mg_dl=jnp.minimum(doubted, jnp.maximum(need, 0.0)),
    )


def most(
    given: Given,
    above_setpoint_mg_dl: jax.Array,
    settings: GuardSettings,
    max_change_mU_min: jax.Array | float,
    sample_time_min: float,
) -> jax.Array:
    """Largest rate that is allowed for the coming sample, never less than the basal rate.

    Insulin on board may reach the amount that lowers glucose to the setpoint if the sensor reads too high by its error
    and by the doubted part. A little more than the basal rate is always allowed, as long as insulin on board is no more
    than that.

    Parameters
    ----------
    given : Given
    above_setpoint_mg_dl : (...) array
        Glucose less the setpoint.
    settings : GuardSettings
    max_change_mU_min : float
        Largest change of the pump's rate from one sample to the next.
    sample_time_min : float
    """
    kept = _kept(settings, sample_time_min)
    surely = above_setpoint_mg_dl - jnp.maximum(given.doubted_mg_dl, 0.0) - settings.error_mg_dl
    target = jnp.minimum(surely * (1.0 / settings.fall_mg_dl), settings.max_on_board)
    by_reading = _most_beyond(target, given, max_change_mU_min, kept, samples_per_hour(sample_time_min))
    little = jnp.minimum(settings.always_basal - 1.0, settings.max_on_board)
    always = jnp.minimum(little, (little - kept * given.counted) * (1.0 / (1.0 - kept)))
    by_board = (1.0 + jnp.maximum(by_reading, always)) * given.basal_mU_min
    return jnp.maximum(jnp.minimum(by_board, _most_of_hour(given, settings, max_change_mU_min)), given.basal_mU_min)


def most_bolus(
    given: Given,
    rate_mU_min: jax.Array,
    settings: GuardSettings,
    max_change_mU_min: jax.Array | float,
    sample_time_min: float,
) -> jax.Array:
    """Largest bolus that is allowed at a sample beside a rate [mU], so that all insulin keeps both caps.

    A bolus counts in the sample in which it is given. Both caps must then hold while the rate goes down from the given
    one to the basal rate, as for a rate alone. Readings do not bound a bolus: that of a meal is needed before glucose
    rises.

    Parameters
    ----------
    given : Given
    rate_mU_min : (...) array
        Rate beside the bolus.
    settings : GuardSettings
    max_change_mU_min : float
        Largest change of the pump's rate from one sample to the next.
    sample_time_min : float
    """
    kept, others = _kept(settings, sample_time_min), given.hour_mU_min.shape[0]
    counted_rate = jnp.maximum(rate_mU_min, given.basal_mU_min)
    beyond, steep = (counted_rate - given.basal_mU_min) * given.per_basal, max_change_mU_min * given.per_basal
    n = np.arange(others + 1)
    # beyond, for n + 1 samples from now on, lowered by a further step at each
    held, lowered, left, own = (
        _column(of, beyond)
        for of in (_after(n, kept, np.ones_like), _after(n, kept, np.asarray), kept ** (n + 1), (1.0 - kept) * kept**n)
    )
    on_board = left * given.counted + (1.0 - kept) * (held * beyond - lowered * steep)
    by_board = jnp.min((settings.max_on_board - on_board) * (1.0 / own), axis=0) * given.basal_mU_min
    cap = settings.max_hour * (others + 1) * given.basal_mU_min
    n = n[::-1]
    past = jnp.concatenate([jnp.zeros_like(cap)[None], jnp.cumsum(given.hour_mU_min[::-1], axis=0)])
    of_rate = _column(n + 1.0, cap) * counted_rate - _column(0.5 * n * (n + 1), cap) * max_change_mU_min
    largest = jnp.minimum(by_board, jnp.min(cap - past - of_rate, axis=0))
    return jnp.maximum(largest, 0.0) * sample_time_min


def _most_beyond(
    target: jax.Array, given: Given, max_change_mU_min: jax.Array | float, kept: float, samples: int
) -> jax.Array:
    """Largest rate beyond the basal rate, in basal rates, from which insulin on board does not pass a target.

    After n more samples of the rate ``z`` going down by ``D`` at each, ``k^(n+1) B + (1 - k) sum_i k^(n-i) (z - i D)``
    is on board. While ``z - i D`` is above 0 that is what the pump gives, and afterwards it is less than that of an
    earlier n; so z is allowed if none of these passes the target. Beyond the last n looked at, a rate below the target
    cannot pass it.
    """
    steep = max_change_mU_min * given.per_basal
    n = np.arange(samples)
    share = kept ** (n + 1)
    left, per_rate = _column(share, target), _column(1.0 / (1.0 - share), target)
    lowered = _column((1.0 - kept) * _after(n, kept, np.asarray), target)
    z = (target - left * given.counted + lowered * steep) * per_rate
    return jnp.minimum(target + samples * steep, jnp.min(z, axis=0))


def _most_of_hour(given: Given, settings: GuardSettings, max_change_mU_min: jax.Array | float) -> jax.Array:
    """Largest rate from which no hour passes its cap, while the rate goes down to the basal rate.

    The hour that ends n samples after the coming one holds ``(n + 1) d - D n (n + 1) / 2`` and the rest of the past.
    """
    others = given.hour_mU_min.shape[0]
    cap = settings.max_hour * (others + 1) * given.basal_mU_min
    n = np.arange(others)[::-1]
    past = jnp.cumsum(given.hour_mU_min[::-1], axis=0)
    later = (cap - past) * _column(1.0 / (n + 1), cap) + _column(0.5 * n, cap) * max_change_mU_min
    return jnp.minimum(cap * (1.0 / (others + 1)) + 0.5 * others * max_change_mU_min, jnp.min(later, axis=0))


def _after(n: NDArray[Any], kept: float, given: Callable[[NDArray[Any]], NDArray[Any]]) -> NDArray[Any]:
    """Sum of ``given(i) kept^(n - i)`` over i from 0 to each n."""
    i = np.arange(n.size, dtype=float)
    return np.asarray(np.where(i <= n[:, None], kept ** (n[:, None] - i), 0.0) @ given(i))


def _column(numbers: NDArray[Any], like: jax.Array) -> jax.Array:
    """Numbers along a first axis before the axes of an array, in its precision."""
    return jnp.asarray(numbers.reshape(-1, *(1,) * like.ndim), like.dtype)


def _kept(settings: GuardSettings, sample_time_min: float) -> float:
    """Share of the insulin on board that is left after a sample."""
    return math.exp(-sample_time_min / settings.on_board_tau_min)


def _inverse(value: jax.Array) -> jax.Array:
    """Inverse of a value; 0 where it is not above 0."""
    some = value > 0.0
    return jnp.where(some, 1.0 / jnp.where(some, value, 1.0), 0.0)


MOST_BOLUS_MU: Final = 100_000.0
"""Largest bolus of any pump; a report beyond it is not believed."""
_ABSURD: Final = 1e4
"""Bound on the numbers of these states; larger ones are corrupted."""
_AGREE: Final = 1e-3
"""Largest deviation from 1 of the basal rate times its inverse."""
