"""Rates of meals that depend on the time of day."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree
from glucoloop.parts.daily_text import DailyValues
from glucoloop.units import MIN_PER_DAY


@pytree
class DailyRates:
    """Periods of the day, each with one of a few rates; make it with `daily_rates`."""

    starts_min: jax.Array
    """(periods,) beginning of each period, in minutes after midnight; the last one ends as the first begins."""
    rate: jax.Array
    """(periods, rates) indicator of the rate of each period; the first rate is for a time that is not known."""

    def at(self, values: Any, time_of_day_min: jax.Array | None) -> Any:
        """Values at a time of day, of arrays with a first axis of rates; the first holds at an unknown time."""
        share = self._share(time_of_day_min)
        return jax.tree.map(lambda leaf: jnp.tensordot(share, leaf, axes=1), values)

    def _share(self, time_of_day_min: jax.Array | None) -> jax.Array:
        """Indicator ``(rates,)`` of the rate at a time of day."""
        unknown = jnp.zeros(self.rate.shape[1]).at[0].set(1.0)
        if time_of_day_min is None:
            return unknown
        begun = (time_of_day_min >= self.starts_min) * 1.0
        now = begun - jnp.append(begun[1:], 0.0)
        now = now.at[-1].add(1.0 - begun[0])  # before the first period the last one of yesterday goes on
        known = (time_of_day_min >= 0.0) & (time_of_day_min < MIN_PER_DAY)
        return jnp.where(known, now @ self.rate, unknown)


def earlier(time_of_day_min: jax.Array, minutes: float) -> jax.Array:
    """Time of day some minutes before a time of day."""
    then = time_of_day_min - minutes % MIN_PER_DAY
    return jnp.where(then < 0.0, then + MIN_PER_DAY, then)


def daily_rates(values: DailyValues, otherwise: float) -> tuple[DailyRates, tuple[float, ...]]:
    """Periods of the day, from their beginnings and rates in order, and the rates ``(rates,)`` that occur in them.

    The first of these is `otherwise`, which holds while the time of day is not known.
    """
    rates = (otherwise, *sorted({rate for _, rate in values} - {otherwise}))
    which = [rates.index(rate) for _, rate in values]
    return (
        DailyRates(
            starts_min=jnp.asarray([start_min for start_min, _ in values], float),
            rate=jnp.asarray(np.eye(len(rates))[which]),
        ),
        rates,
    )
