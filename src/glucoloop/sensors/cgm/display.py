"""Readings as a monitor shows them: in whole steps, within its range, and one every few minutes."""

from __future__ import annotations

from typing import Any

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked
from glucoloop.sensors.cgm.model import Ticks
from glucoloop.sensors.protocol import Reading, Sensor, checked_sample_time, or_ideal
from glucoloop.sensors.settings import DisplaySettings


@pytree
class _State:
    inner: Any
    since: jax.Array | None
    """Parts of a tick since the latest reading; None where each sample has one."""


@pytree
class Display:
    """Shows the reading of the inner sensor; make it with `display`."""

    inner: Sensor
    low_mg_dl: jax.Array | float
    high_mg_dl: jax.Array | float
    step_mg_dl: jax.Array | float
    ticks: Ticks = static()

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State before the first sample, which has a reading."""
        every = self.ticks.ahead >= self.ticks.of_tick
        due = jnp.full(jnp.shape(glucose_mg_dl), float(self.ticks.of_tick), jnp.result_type(float, glucose_mg_dl))
        return _State(inner=self.inner.init(glucose_mg_dl, key), since=None if every else due)

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, and show it if a reading is due; otherwise there is none."""
        inner, reading = self.inner.read(state.inner, glucose_mg_dl, key)
        steps = self.step_mg_dl * jnp.round(reading.glucose_mg_dl / self.step_mg_dl)
        shown, valid, since = jnp.clip(steps, self.low_mg_dl, self.high_mg_dl), reading.valid, state.since
        if since is not None:
            due = since >= self.ticks.of_tick
            since = jnp.where(due, since - self.ticks.of_tick, since) + self.ticks.ahead
            shown, valid = jnp.where(due, shown, jnp.nan), valid & due
        return _State(inner=inner, since=since), Reading(glucose_mg_dl=shown, valid=valid)


@checked
def display(
    low_mg_dl: float = 40.0,
    high_mg_dl: float = 400.0,
    step_mg_dl: float = 1.0,
    every_min: float = 5.0,
    inner: Sensor | None = None,
    *,
    sample_time_min: float = 5.0,
) -> Display:
    """Readings as a monitor shows them.

    Parameters
    ----------
    low_mg_dl, high_mg_dl : float
        Range. Beyond it a monitor shows LOW or HIGH; here the reading is the end of the range, and valid: a controller
        has to act on it.
    step_mg_dl : float
        Step of the readings.
    every_min : float
        Time between two readings. The first sample at or after that time has one, samples between have none: they are
        not a number, and not valid.

    Raises
    ------
    ValueError
        For a setting beyond its bounds, or a range that is empty.
    """
    DisplaySettings(low_mg_dl, high_mg_dl, step_mg_dl, every_min)
    return Display(
        inner=or_ideal(inner),
        low_mg_dl=low_mg_dl,
        high_mg_dl=high_mg_dl,
        step_mg_dl=step_mg_dl,
        ticks=Ticks.seen(checked_sample_time(sample_time_min), every_min),
    )
