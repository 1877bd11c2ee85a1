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
    """(samples, ...) rates of the last hour but one sample, each at least the basal rate."""
    asked_mU_min: jax.Array
    """The last rate that was asked for."""
    asked_bolus_mU: jax.Array | None
    """The last bolus that was asked for; None for a controller that gives none."""
    binds: jax.Array
    """1 while the caps bind, else 0."""


@pytree
class Caps:
    """The caps of one guard."""

    settings: GuardSettings = static()
    limits: DoseLimits = PARKER_1999_LIMITS
    sample_time_min: float = static(default=5.0)
    boluses: bool = static(default=False)
    """Whether the controller gives boluses."""

    def init(self, basal_mU_min: jax.Array) -> Counted:
        """State after a long time at the basal rate."""
        others = max(round(MIN_PER_H / self.sample_time_min), 1) - 1
        return Counted(
            basal_mU_min=basal_mU_min,
            on_board=jnp.zeros_like(basal_mU_min),
            hour_mU_min=jnp.broadcast_to(basal_mU_min, (others, *jnp.shape(basal_mU_min))),
            asked_mU_min=basal_mU_min,
            asked_bolus_mU=jnp.zeros_like(basal_mU_min) if self.boluses else None,
            binds=jnp.ones_like(basal_mU_min),
        )

    def step(
        self,
        counted: Counted,
        told_mU_min: jax.Array,
        asked_mU_min: jax.Array,
        told_bolus_mU: jax.Array | None = None,
        asked_bolus_mU: jax.Array | None = None,
    ) -> tuple[Counted, jax.Array]:
        """Count the insulin of the last sample, and check the dose that is asked for now.

        Parameters
        ----------
        counted : Counted
        told_mU_min : (...) array
            Rate that the pump reports; an impossible one is replaced by the rate that was asked for.
        asked_mU_min : (...) array
        told_bolus_mU, asked_bolus_mU : (...) array, optional
            Boluses in the same way, or None for a controller without boluses.

        Returns
        -------
        Counted, (...) array
            Insulin counted so far, and whether both caps hold or do not bind.
        """
        basal, settings = counted.basal_mU_min, self.settings
        possible = (told_mU_min >= 0.0) & (told_mU_min <= 2.0 * self.limits.max_mU_min)
        given, before = jnp.where(possible, told_mU_min, counted.asked_mU_min), counted.asked_mU_min
        if counted.asked_bolus_mU is not None and told_bolus_mU is not None and asked_bolus_mU is not None:
            known = (told_bolus_mU >= 0.0) & (told_bolus_mU <= MOST_BOLUS_MU)
            given = given + jnp.where(known, told_bolus_mU, counted.asked_bolus_mU) / self.sample_time_min
            before = before + counted.asked_bolus_mU / self.sample_time_min
        asked = asked_mU_min if asked_bolus_mU is None else asked_mU_min + asked_bolus_mU / self.sample_time_min
        on_board = self._on_board(counted.on_board, given, basal)
        hour = jnp.concatenate([counted.hour_mU_min, jnp.maximum(given, basal)[None]])[1:]
        within = on_board <= settings.max_on_board + _ROUNDING
        most_of_hour = settings.max_hour * (hour.shape[0] + 1) * basal * (1.0 + _ROUNDING)
        within = within & (jnp.sum(hour, axis=0) + basal <= most_of_hour)
        binds = jnp.where(given > before + _ROUNDING, 0.0, counted.binds)
        binds = jnp.where((given <= basal) & within, 1.0, binds)
        kept = self._on_board(on_board, asked, basal) <= settings.max_on_board + _ROUNDING
        kept = kept & (jnp.sum(hour, axis=0) + jnp.maximum(asked, basal) <= most_of_hour)
        after = Counted(
            basal_mU_min=basal,
            on_board=on_board,
            hour_mU_min=hour,
            asked_mU_min=asked_mU_min,
            asked_bolus_mU=asked_bolus_mU,
            binds=binds,
        )
        return after, kept | (binds < 0.5)

    def _on_board(self, before: jax.Array, rate_mU_min: jax.Array, basal_mU_min: jax.Array) -> jax.Array:
        left = math.exp(-self.sample_time_min / self.settings.on_board_tau_min)
        return jnp.maximum(before * left + (rate_mU_min / basal_mU_min - 1.0) * (1.0 - left), 0.0)
