"""Wrappers of controllers, sensors and pumps that report with each answer whether the inner state is sound.

A loop passes on their answers but not their states; a wrapper sees both. It does not change a bit of either.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.control.protocol import Controller, Decision, Observation, gives_boluses
from glucoloop.episodes import Episode
from glucoloop.pumps import Delivery, Pump
from glucoloop.pumps.protocol import deliver
from glucoloop.sensors import Reading, Sensor


@pytree
class WatchedDecision(Decision):
    """A decision, with its inputs and the soundness of the controller."""

    told_mU_min: jax.Array
    """Rate that the pump reported."""
    sound: jax.Array
    """Whether the whole state of the controller is finite."""
    told_bolus_mU: jax.Array | None = None
    """Bolus that the pump reported; None for a controller without boluses."""


@pytree
class WatchedReading(Reading):
    """A reading, with the soundness of the sensor."""

    clocks: jax.Array
    """Whether the clock of every fault is valid."""


@pytree
class WatchedDelivery(Delivery):
    """A delivery, with the soundness of the pump."""

    sound: jax.Array
    """Whether the pump's state is finite, apart from the time of a fault that never comes."""
    clocks: jax.Array


@pytree
class WatchedController:
    """Wrapper of a controller of one person."""

    inner: Controller

    @property
    def sample_time_min(self) -> float:
        """Sample time of the inner controller."""
        return self.inner.sample_time_min

    @property
    def gives_boluses(self) -> bool:
        """Whether the inner controller gives boluses."""
        return gives_boluses(self.inner)

    def init(self, observation: Observation) -> Any:
        """State of the inner controller."""
        return self.inner.init(observation)

    def step(self, state: Any, observation: Observation) -> tuple[Any, WatchedDecision]:
        """Decide as the inner controller does."""
        state, decision = self.inner.step(state, observation)
        return state, WatchedDecision(
            insulin_mU_min=decision.insulin_mU_min,
            status=decision.status,
            bolus_mU=decision.bolus_mU,
            told_mU_min=observation.delivered_mU_min,
            sound=all_finite(state),
            told_bolus_mU=observation.delivered_bolus_mU,
        )


@pytree
class WatchedSensor:
    """Wrapper of a sensor of one person.

    Its buffered readings may be any number, since some faults give such readings.
    """

    inner: Sensor

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Any:
        """State of the inner sensor."""
        return self.inner.init(glucose_mg_dl, key)

    def read(self, state: Any, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Any, WatchedReading]:
        """Read as the inner sensor does."""
        state, reading = self.inner.read(state, glucose_mg_dl, key)
        clocks, _ = _clocks_and_others(state)
        return state, WatchedReading(
            glucose_mg_dl=reading.glucose_mg_dl, valid=reading.valid, clocks=_all(map(_tells_time, clocks))
        )


@pytree
class WatchedPump:
    """Wrapper of a pump of one person."""

    inner: Pump

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Any:
        """State of the inner pump."""
        return self.inner.init(insulin_mU_min, key)

    def deliver(
        self, state: Any, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[Any, WatchedDelivery]:
        """Deliver as the inner pump does."""
        state, delivery = deliver(self.inner, state, command_mU_min, key, bolus_mU)
        clocks, others = _clocks_and_others(state)
        return state, WatchedDelivery(
            insulin_mU_min=delivery.insulin_mU_min,
            reported_mU_min=delivery.reported_mU_min,
            bolus_mU=delivery.bolus_mU,
            reported_bolus_mU=delivery.reported_bolus_mU,
            sound=all_finite(others),
            clocks=_all(map(_tells_time, clocks)),
        )


def all_finite(tree: Any) -> jax.Array:
    """Whether all numbers of one person are finite."""
    leaves = map(jnp.asarray, jax.tree.leaves(tree))
    return _all(jnp.all(jnp.isfinite(leaf)) for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.inexact))


def _clocks_and_others(state: Any) -> tuple[list[Episode], list[Any]]:
    parts = jax.tree.leaves(state, is_leaf=lambda part: isinstance(part, Episode))
    clocks = [part for part in parts if isinstance(part, Episode)]
    return clocks, [part for part in parts if not isinstance(part, Episode)]


def _tells_time(clock: Episode) -> jax.Array:
    """Whether the age is a whole number of -1 or more and the time until the onset is a number, or never comes."""
    age, until = clock.age, clock.until
    whole = jnp.isfinite(age) & (age >= -1.0) & (jnp.floor(age) == age)
    return whole & (until == until) & (until > -jnp.inf)


def _all(holds: Any) -> jax.Array:
    together = jnp.asarray(True)
    for one in holds:
        together = together & one
    return together
