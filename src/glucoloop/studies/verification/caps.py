"""Caps of a guard, computed independently from its inputs and outputs.

It shares no code with the guard: insulin on board and in an hour are summed up here a second time. The caps bind as
long as the pump never reports more than it was asked for. If it does, they bind again once the pump is back at the
basal rate and both sums are within their caps; see `control.guard_doses` for why they then hold at every sample.
"""

from __future__ import annotations

import math
from typing import Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.control import GuardSettings
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
    """(samples, ...) rates of the last hour but one sample, each at least the basal rate."""
    asked_mU_min: jax.Array
    """The last rate that was asked for."""
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
        others = max(round(MIN_PER_H / self.sample_time_min), 1) - 1
        return Counted(
            basal_mU_min=basal_mU_min,
            on_board=jnp.zeros_like(basal_mU_min),
            hour_mU_min=jnp.broadcast_to(basal_mU_min, (others, *jnp.shape(basal_mU_min))),
            asked_mU_min=basal_mU_min,
            binds=jnp.ones_like(basal_mU_min),
        )

    def step(self, counted: Counted, told_mU_min: jax.Array, asked_mU_min: jax.Array) -> tuple[Counted, jax.Array]:
        """Count the rate of the last sample, and check the rate that is asked for now.

        Parameters
        ----------
        counted : Counted
        told_mU_min : (...) array
            Rate that the pump reports; an impossible one is replaced by the rate that was asked for.
        asked_mU_min : (...) array

        Returns
        -------
        Counted, (...) array
            Insulin counted so far, and whether both caps hold or do not bind.
        """
        basal, settings = counted.basal_mU_min, self.settings
        possible = (told_mU_min >= 0.0) & (told_mU_min <= 2.0 * self.limits.max_mU_min)
        given = jnp.where(possible, told_mU_min, counted.asked_mU_min)
        on_board = self._on_board(counted.on_board, given, basal)
        hour = jnp.concatenate([counted.hour_mU_min, jnp.maximum(given, basal)[None]])[1:]
        within = on_board <= settings.max_on_board + _ROUNDING
        most_of_hour = settings.max_hour * (hour.shape[0] + 1) * basal * (1.0 + _ROUNDING)
        within = within & (jnp.sum(hour, axis=0) + basal <= most_of_hour)
        binds = jnp.where(given > counted.asked_mU_min + _ROUNDING, 0.0, counted.binds)
        binds = jnp.where((given <= basal) & within, 1.0, binds)
        kept = self._on_board(on_board, asked_mU_min, basal) <= settings.max_on_board + _ROUNDING
        kept = kept & (jnp.sum(hour, axis=0) + jnp.maximum(asked_mU_min, basal) <= most_of_hour)
        after = Counted(basal_mU_min=basal, on_board=on_board, hour_mU_min=hour, asked_mU_min=asked_mU_min, binds=binds)
        return after, kept | (binds < 0.5)

    def _on_board(self, before: jax.Array, rate_mU_min: jax.Array, basal_mU_min: jax.Array) -> jax.Array:
        left = math.exp(-self.sample_time_min / self.settings.on_board_tau_min)
        return jnp.maximum(before * left + (rate_mU_min / basal_mU_min - 1.0) * (1.0 - left), 0.0)
