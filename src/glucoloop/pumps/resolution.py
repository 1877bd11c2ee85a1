"""A pump that can only deliver multiples of a smallest rate."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.pumps.limited import LimitedPump
from glucoloop.pumps.protocol import Delivery


@pytree
class _Carry:
    inner: jax.Array
    owed_mU_min: jax.Array


@pytree
class Resolution:
    """Rounds what the pump inside delivers down to whole steps, and owes the rest to the next sample.

    What is owed, at most one step, is carried over, so that the mean dose is right to one step unless the upper limit
    is in the way. The dose stays at or below that limit, while a change may exceed the rate limit by less than two
    steps.
    """

    inner: LimitedPump
    step_mU_min: float

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> _Carry:
        """Nothing is owed at the start."""
        return _Carry(inner=self.inner.init(insulin_mU_min, key), owed_mU_min=jnp.zeros_like(insulin_mU_min))

    def deliver(self, state: _Carry, command_mU_min: jax.Array, key: jax.Array) -> tuple[_Carry, Delivery]:
        """Deliver whole steps."""
        inner, wanted = self.inner.deliver(state.inner, command_mU_min, key)
        due = wanted.insulin_mU_min + state.owed_mU_min
        # A hair is added because a whole number of steps may come out just below itself.
        most = jnp.minimum(due, self.inner.limits.max_mU_min)
        delivered = jnp.floor(most / self.step_mU_min + 1e-9) * self.step_mU_min
        return _Carry(inner=inner, owed_mU_min=jnp.minimum(due - delivered, self.step_mU_min)), Delivery(
            insulin_mU_min=delivered, reported_mU_min=delivered
        )


def with_resolution(step_mU_min: float, inner: LimitedPump | None = None) -> Resolution:
    """Pump with a delivery resolution.

    Raises
    ------
    ValueError
        Unless the step is positive and finite.
    """
    if not 0.0 < step_mU_min < math.inf:
        raise ValueError(
            f"a delivery resolution of {step_mU_min:g} mU/min is not possible; give a finite value above 0"
        )
    return Resolution(inner=inner if inner is not None else LimitedPump(), step_mU_min=float(step_mU_min))
