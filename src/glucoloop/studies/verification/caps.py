"""Caps of a guard, computed independently from its inputs and outputs.

It shares no code with the guard: insulin on board and in an hour are summed up here a second time, the hour over every
window of 60 min that ends in the coming sample and can be the largest. A bolus counts whole at the beginning of its
sample. The caps bind as long as the pump never reports more than it was asked for. If it does, they bind again once the
pump is back at the basal rate and both sums are within their caps; see `control.guard_doses` for why they then hold at
every sample.
"""

from __future__ import annotations

import math
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop.control import GuardSettings
from glucoloop.control.guard_doses import MOST_BOLUS_MU
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.units import MIN_PER_H

_ROUNDING: Final = 1e-9


@pytree
class Counted:
    """Insulin counted so far, and whether the caps bind."""

    basal_mU_min: jax.Array
    on_board: jax.Array
    """Insulin on board beyond the basal rate, in basal rates; never below 0."""
    hour_mU_min: jax.Array
    """(samples, ...) rates of somewhat more than the last hour, each at least the basal rate."""
    hour_bolus_mU: jax.Array
    """(samples, ...) boluses of that time."""
    asked_mU_min: jax.Array
    """The last rate that was asked for."""
    asked_bolus_mU: jax.Array
    """The last bolus that was asked for; 0 for a controller that gives none."""
    binds: jax.Array
    """1 while the caps bind, else 0."""


@pytree
class Caps:
    """The caps of one guard."""

    settings: GuardSettings = static()
    limits: DoseLimits = PARKER_1999_LIMITS
    sample_time_min: float = static(default=5.0)

    def init(self, basal_mU_min: jax.Array) -> Counted:
        """State after a long time at the basal rate."""
        hour = math.ceil(MIN_PER_H / self.sample_time_min) + 1, *jnp.shape(basal_mU_min)
        none = jnp.zeros_like(basal_mU_min)
        return Counted(
            basal_mU_min=basal_mU_min,
            on_board=none,
            hour_mU_min=jnp.broadcast_to(basal_mU_min, hour),
            hour_bolus_mU=jnp.broadcast_to(none, hour),
            asked_mU_min=basal_mU_min,
            asked_bolus_mU=none,
            binds=jnp.ones_like(basal_mU_min),
        )

    def step(
        self,
        counted: Counted,
        reported_mU_min: jax.Array,
        asked_mU_min: jax.Array,
        reported_bolus_mU: jax.Array | None = None,
        asked_bolus_mU: jax.Array | None = None,
    ) -> tuple[Counted, jax.Array]:
        """Count the insulin of the last sample, and say whether both caps hold for the next dose, or do not bind.

        What the pump reports is counted; in place of an impossible report, what it was asked for. Without boluses they
        are None.
        """
        basal, most_on_board = counted.basal_mU_min, self.settings.max_on_board + _ROUNDING
        none = jnp.zeros_like(basal)
        reported_bolus = none if reported_bolus_mU is None else reported_bolus_mU
        bolus = none if asked_bolus_mU is None else asked_bolus_mU
        possible = (reported_mU_min >= 0.0) & (reported_mU_min <= 2.0 * self.limits.max_mU_min)
        given = jnp.where(possible, reported_mU_min, counted.asked_mU_min)
        possible = (reported_bolus >= 0.0) & (reported_bolus <= MOST_BOLUS_MU)
        given_bolus = jnp.where(possible, reported_bolus, counted.asked_bolus_mU)
        hour = jnp.concatenate([counted.hour_mU_min[1:], jnp.maximum(given, basal)[None]])
        boluses = jnp.concatenate([counted.hour_bolus_mU[1:], given_bolus[None]])
        on_board = self._on_board(counted.on_board, given + given_bolus / self.sample_time_min, basal)
        within = (on_board <= most_on_board) & self._hours_hold(hour, boluses, basal, none, basal)
        more = (given > counted.asked_mU_min + _ROUNDING) | (given_bolus > counted.asked_bolus_mU + _ROUNDING)
        binds = jnp.where(more, 0.0, counted.binds)
        binds = jnp.where((given <= basal) & (given_bolus <= 0.0) & within, 1.0, binds)
        at_once = on_board + bolus / (self.settings.on_board_tau_min * basal)
        later = self._on_board(on_board, asked_mU_min + bolus / self.sample_time_min, basal)
        satisfied = jnp.maximum(at_once, later) <= most_on_board
        satisfied = satisfied & self._hours_hold(hour, boluses, jnp.maximum(asked_mU_min, basal), bolus, basal)
        after = Counted(
            basal_mU_min=basal,
            on_board=on_board,
            hour_mU_min=hour,
            hour_bolus_mU=boluses,
            asked_mU_min=asked_mU_min,
            asked_bolus_mU=bolus,
            binds=binds,
        )
        return after, satisfied | (binds < 0.5)

    def _hours_hold(
        self, past_mU_min: jax.Array, past_mU: jax.Array, rate_mU_min: jax.Array, bolus_mU: jax.Array, basal: jax.Array
    ) -> jax.Array:
        """Whether no window of 60 min that ends in the coming sample holds more than its cap."""
        of_rates, of_boluses = _windows(past_mU_min.shape[0], self.sample_time_min)
        rates = jnp.concatenate([past_mU_min, rate_mU_min[None]])
        boluses = jnp.concatenate([past_mU, bolus_mU[None]])
        held = jnp.tensordot(of_rates, rates, 1) + jnp.tensordot(of_boluses, boluses, 1)
        return jnp.max(held, axis=0) <= self.settings.max_hour * MIN_PER_H * basal * (1.0 + _ROUNDING)

    def _on_board(self, before: jax.Array, rate_mU_min: jax.Array, basal_mU_min: jax.Array) -> jax.Array:
        left = math.exp(-self.sample_time_min / self.settings.on_board_tau_min)
        return jnp.maximum(before * left + (rate_mU_min / basal_mU_min - 1.0) * (1.0 - left), 0.0)


def _windows(past: int, sample_time_min: float) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """(windows, past + 1) minutes of each sample in windows of 60 min, and whether its bolus is in them.

    The last sample is the coming one. What a window holds is linear in the time of its end as long as neither end
    passes the border of a sample, so that no other windows need to be looked at.
    """
    begins = sample_time_min * np.arange(-past, 1)
    ends = np.array([0.0, sample_time_min])
    inside = begins + MIN_PER_H
    ends = np.concatenate([ends, inside[(inside > 0.0) & (inside < sample_time_min)]])[:, None]
    minutes = np.minimum(ends, begins + sample_time_min) - np.maximum(ends - MIN_PER_H, begins)
    hair = _ROUNDING * sample_time_min
    holds = (begins >= ends - MIN_PER_H - hair) & (begins <= ends + hair)
    return np.maximum(minutes, 0.0), holds.astype(float)
