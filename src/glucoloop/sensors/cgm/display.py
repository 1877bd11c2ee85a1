"""Readings as a monitor shows them: in whole steps, within its range, and one every few minutes."""

from __future__ import annotations

from typing import Annotated, Any

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.pytree_component import HOST, derived_static
from glucoloop.component.setting import About
from glucoloop.refusal import Refusal
from glucoloop.sensors.cgm.model import Ticks
from glucoloop.sensors.delay import LONGEST_LAG_MIN
from glucoloop.sensors.protocol import Reading, SensorAround
from glucoloop.unit_guess import GLUCOSE_BOUND


@pytree
class _State:
    inner: Any
    since: jax.Array | None
    """Parts of a tick since the latest reading; None where each sample has one."""


class Display(SensorAround, name="cgm-display"):
    """Readings as a continuous glucose monitor shows them: its range, whole steps, one every few minutes.

    Beyond its range a monitor shows LOW or HIGH; here the reading is the end of the range, and valid: a controller has
    to act on it. The first sample at or after the time of a reading has one, samples between have none: they are not a
    number, and not valid.
    """

    low_mg_dl: Annotated[
        float,
        About("Lower end of the range, which is given for less.", at_least=0.0, at_most=2000.0, quantity=GLUCOSE_BOUND),
    ] = 40.0
    high_mg_dl: Annotated[
        float,
        About("Upper end of the range, which is given for more.", above=0.0, at_most=2000.0, quantity=GLUCOSE_BOUND),
    ] = 400.0
    step_mg_dl: Annotated[float, About("Step of the readings.", above=0.0, at_most=100.0)] = 1.0
    every_min: Annotated[
        float, About("Time between two readings; samples between have none.", above=0.0, at_most=LONGEST_LAG_MIN), HOST
    ] = 5.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low_mg_dl < self.high_mg_dl:
            raise Refusal(
                f"a range of {self.low_mg_dl:g} to {self.high_mg_dl:g} mg/dl is not possible; "
                f"{GLUCOSE_BOUND.looks_like(self.high_mg_dl) or 'give an upper end above the lower one'}"
            )

    @derived_static
    def ticks(self) -> Ticks:
        """Times of the readings."""
        return Ticks.seen(self.sample_time_min, self.every_min)

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> _State:
        """State before the first sample, which has a reading."""
        every = self.ticks.ahead >= self.ticks.of_tick
        due = jnp.full(jnp.shape(glucose_mg_dl), float(self.ticks.of_tick), jnp.result_type(float, glucose_mg_dl))
        return _State(inner=self.inner.init(glucose_mg_dl, key), since=None if every else due)

    def read(self, state: _State, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[_State, Reading]:
        """Read the inner sensor, and show it if a reading is due; otherwise there is none."""
        inner, reading = self.inner.read(state.inner, glucose_mg_dl, key)
        steps = self.step_mg_dl * jnp.round(reading.glucose_mg_dl / self.step_mg_dl)
        display, valid, since = jnp.clip(steps, self.low_mg_dl, self.high_mg_dl), reading.valid, state.since
        if since is not None:
            due = since >= self.ticks.of_tick
            since = jnp.where(due, since - self.ticks.of_tick, since) + self.ticks.ahead
            display, valid = jnp.where(due, display, jnp.nan), valid & due
        return _State(inner=inner, since=since), Reading(glucose_mg_dl=display, valid=valid)
