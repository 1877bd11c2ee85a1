"""Largest dose that a guard allows: in an hour, on board, and for the present reading.

Insulin on board is counted in basal rates beyond the basal rate: it is 1 after long at twice the basal rate, and a
bolus of one basal rate for one time constant adds 1.

Two caps are bounds that hold at any time: insulin in an hour, and insulin on board. A pump can lower its rate only by
``D`` per sample, so a rate may be allowed only if the caps still hold while the rate goes down from it to the basal
rate as fast as the pump can. Call a state safe if that is so for the rate in force. Then:

1. In a safe state the next rate on the way down is allowed, by the definition of safe.
2. Both caps grow with every rate, so every rate below an allowed one is allowed too, the basal rate included.
3. The guard gives at most the largest allowed rate, or the next one on the way down. Either leaves a safe state.

So from a safe state every later one is safe, for any readings and any controller, as long as the pump gives no more
than it was asked for. If it reports that it gave more, the guard takes the rate down as fast as the pump can until the
caps hold.

No report of a pump lowers the count. A report of less than was asked for may be true, as after an occlusion, or false,
and nothing that a guard is told tells these apart: an occlusion that ended looks like a report that was wrong. So what
counts of a sample is the largest of three rates, the one that was asked for, the one that was reported, and the one
that counted before less ``D``, below which the pump may not have come; and of two boluses the larger. A pump that gives
what it was asked for, or goes there from a higher rate as fast as it can, never gives more than this. Both caps grow
with every past rate, so what it truly gave keeps them too, whatever it reports.

An hour is any window of 60 min, at whatever time it begins, its ends included. Rates are constant over a sample, and a
bolus counts whole at the beginning of its sample. Between two windows that begin or end between samples the insulin of
a window changes linearly, so the largest window begins at the beginning of a sample or ends at the end of one. With
``60 min = m T + w``, ``0 <= w < T``, these are, for i past and k = m - i coming samples::

    A_i + b + T (c_0 + ... + c_(k-1)) + w max(c_k, p_(i+1)),    i = 0 .. m

where ``A_i`` is all insulin of the last i samples, ``b`` the coming bolus, ``c`` the coming rates, ``p_(i+1)`` the rate
before those i samples: the part ``w`` of a sample is either at the end of the window or at its beginning.

A bolus is allowed only if both caps hold with it on the whole way down from the rate beside it, so that a state after
it is safe too, and insulin on board keeps its cap at once, as if the pump gave the bolus in a moment. Afterwards it
counts as if it had been spread over its sample, which leaves more on board. So the cap holds for either way of giving
it.

In an hour a rate below the basal rate counts as the basal rate, and insulin on board never counts as less than at the
basal rate. So insulin that was withheld is never given later, and the way down never has to go below the basal rate.

The record from which both caps are counted has a check sum. If that does not agree with the record, every number of
the record is taken for the largest that it can be, which allows no more than the basal rate until they no longer
count: for an hour, and longer where more may be on board.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop.control.guard_settings import GuardSettings
from glucoloop.units import MIN_PER_H


@pytree
class DoseHistory:
    """Past insulin, and the part of the readings that is attributed to the sensor."""

    basal_mU_min: jax.Array
    per_basal: jax.Array
    """Inverse of the basal rate; 0 where that is 0."""
    on_board: jax.Array
    """Insulin on board, below 0 after a time below the basal rate."""
    counted: jax.Array
    """Insulin on board as the cap counts it, which never falls below 0."""
    hour_mU_min: jax.Array
    """(samples, ...) rates of the last hour, the oldest first, each at least the basal rate."""
    rate_mU_min: jax.Array
    """Largest rate that the pump can have given in the last sample."""
    sensor_jump_mg_dl: jax.Array
    """Part of the reading that is attributed to the sensor; below 0 after a jump down, which may be reversed."""
    check: jax.Array
    """Check sum of the record: of `counted`, the hour, the last rate, and the last dose that was asked for. It is below
    0 in the first state, which may have been rounded to single precision since.
    """
    hour_bolus_mU: jax.Array | None = None
    """(samples, ...) boluses of the last hour, the oldest first; None where none are given."""

    def agrees(self, requested_mU_min: jax.Array, requested_bolus_mU: jax.Array | None) -> jax.Array:
        """Whether the check sum agrees with the record, up to rounding."""
        eps = jnp.where(self.check < 0.0, jnp.finfo(jnp.float32).eps, jnp.finfo(self.check.dtype).eps)
        rounding = 8.0 * (self.hour_mU_min.shape[0] + 5) * eps
        difference = jnp.abs(jnp.abs(self.check) - self._sum(requested_mU_min, requested_bolus_mU))
        return difference <= rounding * jnp.abs(self.check)

    def with_check(self, requested_mU_min: jax.Array, requested_bolus_mU: jax.Array | None) -> DoseHistory:
        """The same record with its check sum."""
        return dataclasses.replace(self, check=self._sum(requested_mU_min, requested_bolus_mU))

    def with_first_check(self, requested_mU_min: jax.Array, requested_bolus_mU: jax.Array | None) -> DoseHistory:
        """The same record with the check sum of a first state."""
        return dataclasses.replace(self, check=-self._sum(requested_mU_min, requested_bolus_mU))

    def _sum(self, requested_mU_min: jax.Array, requested_bolus_mU: jax.Array | None) -> jax.Array:
        # It is above 0 for every record, so that a record of zeros has no check sum of zero.
        total = 1.0 + self.counted + self.rate_mU_min + requested_mU_min + jnp.sum(self.hour_mU_min, axis=0)
        if self.hour_bolus_mU is None or requested_bolus_mU is None:
            return total
        return total + requested_bolus_mU + jnp.sum(self.hour_bolus_mU, axis=0)


@pytree
class OwnLimits:
    """Limits of insulin of a person, in basal rates and basal hours, as the settings have them."""

    max_hour: jax.Array | float
    max_on_board: jax.Array | float
    fall_mg_dl: jax.Array | float

    @classmethod
    def of(cls, settings: GuardSettings, carb_share: jax.Array | float, fall_share: jax.Array | float) -> OwnLimits:
        """Limits of a person whose meals need so many times the usual insulin, which lowers glucose so many times."""
        return cls(
            max_hour=1.0 + (settings.max_hour - 1.0) * carb_share,
            max_on_board=settings.max_on_board * carb_share,
            fall_mg_dl=settings.fall_mg_dl * fall_share,
        )


@dataclass(frozen=True)
class Hour:
    """Any window of 60 min in samples: ``60 min = whole T + part_min``."""

    whole: int
    part_min: float
    sample_time_min: float

    @classmethod
    def of(cls, sample_time_min: float) -> Hour:
        """Windows at a sample time."""
        whole = math.floor(MIN_PER_H / sample_time_min + _AGREE_SAMPLES)
        part_min = MIN_PER_H - whole * sample_time_min
        return cls(whole, part_min if part_min > _AGREE_SAMPLES * sample_time_min else 0.0, sample_time_min)

    @property
    def samples(self) -> int:
        """Number of samples of a window that begins at the beginning of one."""
        return self.whole + (self.part_min > 0.0)


def initial_doses(
    basal_mU_min: jax.Array, rate_mU_min: jax.Array, sample_time_min: float, no_bolus_mU: jax.Array | None
) -> DoseHistory:
    """State after a long time at the basal rate, with a rate in force; the bolus is None for a controller without."""
    zero, samples = jnp.zeros_like(basal_mU_min), Hour.of(sample_time_min).samples
    return DoseHistory(
        basal_mU_min=basal_mU_min,
        per_basal=_inverse(basal_mU_min),
        on_board=zero,
        counted=zero,
        hour_mU_min=jnp.broadcast_to(basal_mU_min, (samples, *basal_mU_min.shape)),
        rate_mU_min=rate_mU_min,
        sensor_jump_mg_dl=zero,
        check=zero,
        hour_bolus_mU=None if no_bolus_mU is None else jnp.broadcast_to(no_bolus_mU, (samples, *no_bolus_mU.shape)),
    )


def repaired_doses(
    doses: DoseHistory,
    intact: jax.Array,
    basal_mU_min: jax.Array,
    own: OwnLimits,
    highest_mU_min: jax.Array | float,
    before_mU_min: jax.Array | float,
) -> DoseHistory:
    """Replace every impossible number of this state by the one that allows the minimum insulin.

    `basal_mU_min` is NaN for a guard built without a basal rate, `most_mU_min` the highest rate that may be reported,
    and `before_mU_min` one from which the pump comes down to the highest that may be asked for.
    """

    def rate(value: jax.Array) -> jax.Array:
        return (value >= 0.0) & (value <= highest_mU_min)

    # The basal rate is in the state twice. If the two disagree, the rate of the guard holds, or else the lower one.
    one, other = doses.basal_mU_min, _inverse(doses.per_basal)
    none = (one == 0.0) & (doses.per_basal == 0.0)
    sound = rate(one) & ((jnp.abs(one * doses.per_basal - 1.0) < _AGREE) | none)
    other = jnp.where(rate(other) & (other > _AGREE), other, highest_mU_min)
    lower = jnp.where(rate(one), jnp.minimum(one, other), jnp.where(other < highest_mU_min, other, 0.0))
    basal = jnp.where(sound, one, jnp.where(rate(basal_mU_min), basal_mU_min, lower))
    cap, boluses = own.max_on_board, doses.hour_bolus_mU
    return DoseHistory(
        basal_mU_min=basal,
        per_basal=jnp.where(sound, doses.per_basal, _inverse(basal)),
        on_board=jnp.where(jnp.abs(doses.on_board) < _ABSURD, doses.on_board, cap),
        counted=jnp.where(intact, doses.counted, cap),
        hour_mU_min=jnp.where(intact, doses.hour_mU_min, highest_mU_min),
        rate_mU_min=jnp.where(intact, doses.rate_mU_min, before_mU_min),
        sensor_jump_mg_dl=jnp.where(jnp.abs(doses.sensor_jump_mg_dl) < _ABSURD, doses.sensor_jump_mg_dl, _ABSURD),
        check=doses.check,
        hour_bolus_mU=None if boluses is None else jnp.where(intact, boluses, MAX_BOLUS_MU),
    )


def at_basal(doses: DoseHistory, basal_mU_min: jax.Array) -> DoseHistory:
    """The same insulin counted in another basal rate, which holds from this sample on by a schedule.

    Without a basal rate, of the one before or the other, insulin on board cannot be counted anew, and stays as it is.
    """
    scale = jnp.where(
        (doses.basal_mU_min > 0.0) & (basal_mU_min > 0.0), doses.basal_mU_min * _inverse(basal_mU_min), 1.0
    )
    return dataclasses.replace(
        doses,
        basal_mU_min=basal_mU_min,
        per_basal=_inverse(basal_mU_min),
        on_board=doses.on_board * scale,
        counted=doses.counted * scale,
    )


def largest_possible_rate(
    doses: DoseHistory, requested_mU_min: jax.Array, reported_mU_min: jax.Array, max_change_mU_min: jax.Array | float
) -> jax.Array:
    """Largest rate that the pump can give in a sample: it is what counts, whatever the pump reports.

    It is the largest of what was asked for, what was reported, and what the pump comes down to from the rate before.
    """
    return jnp.maximum(jnp.maximum(requested_mU_min, reported_mU_min), doses.rate_mU_min - max_change_mU_min)


def largest_possible_bolus(basal_mU_min: jax.Array, own: OwnLimits, settings: GuardSettings) -> jax.Array:
    """Largest bolus that a guard can have asked for [mU]: all that may be on board, at once."""
    return jnp.minimum(own.max_on_board * settings.on_board_tau_min * basal_mU_min, MAX_BOLUS_MU)


def updated_doses(
    doses: DoseHistory,
    delivered_mU_min: jax.Array,
    delivered_bolus_mU: jax.Array | None,
    above_setpoint_mg_dl: jax.Array,
    jump_mg_dl: jax.Array,
    own: OwnLimits,
    settings: GuardSettings,
    sample_time_min: float,
) -> DoseHistory:
    """Include the insulin of the last sample, and the jump of the reading that is attributed to the sensor.

    Glucose does not jump: a jump is attributed to the sensor as far as it would call for more insulin, and forgotten
    gradually.
    """
    left_share, boluses = _left_share(settings, sample_time_min), doses.hour_bolus_mU
    infused = delivered_mU_min
    if boluses is not None and delivered_bolus_mU is not None:
        infused = infused + delivered_bolus_mU / sample_time_min
        boluses = jnp.concatenate([boluses[1:], delivered_bolus_mU[None]])
    beyond = (infused - doses.basal_mU_min) * doses.per_basal
    on_board = left_share * doses.on_board + (1.0 - left_share) * beyond
    # How far glucose is above the setpoint, and how far insulin on board has lowered it.
    need = above_setpoint_mg_dl + own.fall_mg_dl * on_board
    sensor_jump = math.exp(-sample_time_min / settings.doubt_tau_min) * doses.sensor_jump_mg_dl + jump_mg_dl
    counted = jnp.maximum(delivered_mU_min, doses.basal_mU_min)
    return DoseHistory(
        basal_mU_min=doses.basal_mU_min,
        per_basal=doses.per_basal,
        on_board=on_board,
        counted=jnp.maximum(left_share * doses.counted + (1.0 - left_share) * beyond, 0.0),
        hour_mU_min=jnp.concatenate([doses.hour_mU_min[1:], counted[None]]),
        rate_mU_min=delivered_mU_min,
        sensor_jump_mg_dl=jnp.minimum(sensor_jump, jnp.maximum(need, 0.0)),
        check=doses.check,
        hour_bolus_mU=boluses,
    )


def largest_allowed_rate(
    doses: DoseHistory,
    above_setpoint_mg_dl: jax.Array,
    unchanged: jax.Array,
    own: OwnLimits,
    settings: GuardSettings,
    max_change_mU_min: jax.Array | float,
    sample_time_min: float,
) -> jax.Array:
    """Largest rate that is allowed for the coming sample, never less than the basal rate.

    Insulin on board may reach the amount that lowers glucose to the setpoint if the sensor reads too high by its error
    and by the part that is attributed to it. A reading that is the same as the one before calls for no more than is on
    board: where a sensor is stuck, glucose falls unseen. A little more than the basal rate is always allowed, as long
    as insulin on board is no more than that.
    """
    left_share = _left_share(settings, sample_time_min)
    surely = above_setpoint_mg_dl - jnp.maximum(doses.sensor_jump_mg_dl, 0.0) - settings.error_mg_dl
    target = jnp.minimum(surely * (1.0 / own.fall_mg_dl), own.max_on_board)
    target = jnp.where(unchanged, jnp.minimum(target, doses.counted), target)
    by_reading = _largest_beyond(target, doses, max_change_mU_min, left_share)
    little = jnp.minimum(settings.always_basal - 1.0, own.max_on_board)
    always = jnp.minimum(little, (little - left_share * doses.counted) * (1.0 / (1.0 - left_share)))
    by_board = (1.0 + jnp.maximum(by_reading, always)) * doses.basal_mU_min
    return jnp.maximum(
        jnp.minimum(by_board, _largest_of_hour(doses, own, max_change_mU_min, sample_time_min)), doses.basal_mU_min
    )


def largest_allowed_bolus(
    doses: DoseHistory,
    rate_mU_min: jax.Array,
    own: OwnLimits,
    settings: GuardSettings,
    max_change_mU_min: jax.Array | float,
    sample_time_min: float,
) -> jax.Array:
    """Largest bolus that is allowed at a sample beside a rate [mU], so that all insulin keeps both caps.

    Both caps must hold at once and while the rate goes down from the given one to the basal rate, as for a rate alone.
    Readings do not bound a bolus: that of a meal is needed before glucose rises.
    """
    left_share, n = _left_share(settings, sample_time_min), np.arange(doses.hour_mU_min.shape[0])
    counted_rate = jnp.maximum(rate_mU_min, doses.basal_mU_min)
    beyond, steep = (counted_rate - doses.basal_mU_min) * doses.per_basal, max_change_mU_min * doses.per_basal
    # beyond, for n + 1 samples from now on, lowered by a further step at each
    unchanged, lowered, left, per_bolus = (
        _column(values, beyond)
        for values in (
            _after(n, left_share, np.ones_like),
            _after(n, left_share, np.asarray),
            left_share ** (n + 1),
            sample_time_min / ((1.0 - left_share) * left_share**n),
        )
    )
    on_board = left * doses.counted + (1.0 - left_share) * (unchanged * beyond - lowered * steep)
    at_once = (own.max_on_board - doses.counted) * settings.on_board_tau_min
    spread = jnp.min((own.max_on_board - on_board) * per_bolus, axis=0)
    by_board = jnp.minimum(at_once, spread) * doses.basal_mU_min
    hours = _hours(doses, own, sample_time_min)
    of_rate = _column(hours.rate_min, beyond) * counted_rate - _column(hours.steps_min, beyond) * max_change_mU_min
    by_hour = jnp.minimum(jnp.min(hours.rest_mU - of_rate, axis=0), jnp.min(hours.before_mU, axis=0))
    return jnp.maximum(jnp.minimum(by_board, by_hour), 0.0)


def _largest_beyond(
    target: jax.Array, doses: DoseHistory, max_change_mU_min: jax.Array | float, left_share: float
) -> jax.Array:
    """Largest rate beyond the basal rate, in basal rates, from which insulin on board does not pass a target.

    After n more samples of the rate ``z`` going down by ``D`` at each, ``k^(n+1) B + (1 - k) sum_i k^(n-i) (z - i D)``
    is on board. While ``z - i D`` is above 0 that is what the pump gives, and afterwards it is less than that of an
    earlier n; so z is allowed if none of these passes the target. Beyond the last n looked at, a rate below the target
    cannot pass it.
    """
    steep, samples = max_change_mU_min * doses.per_basal, doses.hour_mU_min.shape[0]
    n = np.arange(samples)
    share = left_share ** (n + 1)
    left, per_rate = _column(share, target), _column(1.0 / (1.0 - share), target)
    lowered = _column((1.0 - left_share) * _after(n, left_share, np.asarray), target)
    z = (target - left * doses.counted + lowered * steep) * per_rate
    return jnp.minimum(target + samples * steep, jnp.min(z, axis=0))


@dataclass(frozen=True)
class _Hours:
    """Windows of an hour that contain coming insulin, with those that begin at a sample before those that end at one.

    Of a rate ``z`` that is lowered by ``D`` at each sample a window holds ``rate_min z - steps_min D``.
    """

    rate_min: npt.NDArray[Any]
    steps_min: npt.NDArray[Any]
    rest_mU: jax.Array
    """(windows, ...) cap less past insulin."""
    before_mU: jax.Array
    """(1, ...) the same of the window that ends now, in which of coming insulin only a bolus can be."""


def _hours(doses: DoseHistory, own: OwnLimits, sample_time_min: float) -> _Hours:
    """Windows of an hour with i past and k coming samples, and a part of one more at either end."""
    hour = Hour.of(sample_time_min)
    cap = own.max_hour * MIN_PER_H * doses.basal_mU_min
    amounts = sample_time_min * doses.hour_mU_min
    if doses.hour_bolus_mU is not None:
        amounts = amounts + doses.hour_bolus_mU
    none = jnp.zeros_like(amounts[:1])
    # of i = 0 .. m past samples, the newest first
    past = jnp.concatenate([none, jnp.cumsum(amounts[::-1][: hour.whole], axis=0)])
    k = np.arange(hour.whole, -1, -1)
    rate_min, steps_min = sample_time_min * k, sample_time_min * 0.5 * k * (k - 1.0)
    if hour.part_min == 0.0:
        rest = cap - past
        return _Hours(rate_min[:-1], steps_min[:-1], rest[:-1], rest[-1:])
    rest = cap - jnp.concatenate([past, past + hour.part_min * doses.hour_mU_min[::-1]])
    return _Hours(
        rate_min=np.concatenate([rate_min + hour.part_min, rate_min[:-1]]),
        steps_min=np.concatenate([steps_min + hour.part_min * k, steps_min[:-1]]),
        rest_mU=rest[:-1],
        before_mU=rest[-1:],
    )


def _largest_of_hour(
    doses: DoseHistory, own: OwnLimits, max_change_mU_min: jax.Array | float, sample_time_min: float
) -> jax.Array:
    """Largest rate from which no hour passes its cap, while the rate goes down to the basal rate.

    A rate that would go on down below the basal rate is not looked at: of the windows with the basal rate in its place
    none holds more than an earlier one.
    """
    hours = _hours(doses, own, sample_time_min)
    lowered = _column(hours.steps_min / hours.rate_min, doses.basal_mU_min) * max_change_mU_min
    return jnp.min(hours.rest_mU * _column(1.0 / hours.rate_min, doses.basal_mU_min) + lowered, axis=0)


def _after(
    n: npt.NDArray[Any], left_share: float, term: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]
) -> npt.NDArray[Any]:
    """Sum of ``term(i) left_share^(n - i)`` over i from 0 to each n."""
    i = np.arange(n.size, dtype=float)
    return np.asarray(np.where(i <= n[:, None], left_share ** (n[:, None] - i), 0.0) @ term(i))


def _column(numbers: npt.NDArray[Any], like: jax.Array) -> jax.Array:
    """Numbers along a first axis before the axes of an array, in its precision."""
    return jnp.asarray(numbers.reshape(-1, *(1,) * like.ndim), like.dtype)


def _left_share(settings: GuardSettings, sample_time_min: float) -> float:
    """Share of the insulin on board that is left after a sample."""
    return math.exp(-sample_time_min / settings.on_board_tau_min)


def _inverse(value: jax.Array) -> jax.Array:
    """Inverse of a value; 0 where it is not above 0."""
    some = value > 0.0
    return jnp.where(some, 1.0 / jnp.where(some, value, 1.0), 0.0)


MAX_BOLUS_MU: Final = 100_000.0
"""Largest bolus of any pump; a report beyond it is not accepted."""
_AGREE_SAMPLES: Final = 1e-9
"""Part of a sample that is the rounding of a sample time that divides an hour."""
_ABSURD: Final = 1e4
"""Bound on the numbers of these states; larger ones are corrupted."""
_AGREE: Final = 1e-3
"""Largest deviation from 1 of the basal rate times its inverse."""
