"""A controller whose doses are known beforehand, to see in a loop what a search found."""

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.control import Decision, Status


@pytree
class GivenDoses:
    """Gives doses one after the other."""

    doses: jax.Array
    sample_time_min: float = static(default=5.0)

    def init(self, observation):
        return jnp.asarray(0)

    def step(self, state, observation):
        return state + 1, Decision(insulin_mU_min=self.doses[state], status=jnp.asarray(Status.OK))
