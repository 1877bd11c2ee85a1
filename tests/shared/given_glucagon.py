"""A controller of a constant rate that gives glucagon once."""

import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop.control import Decision, Status


@pytree
class GivenGlucagon:
    """Gives a dose at a sample, and boluses of insulin at the first one."""

    insulin_mU_min: object
    glucagon_ug: object
    at: int = static(default=0)
    bolus_mU: object = 0.0
    sample_time_min: float = static(default=5.0)

    gives_boluses = True
    gives_glucagon = True

    def init(self, observation):
        return 0.0 * observation.glucose_mg_dl

    def step(self, state, observation):
        zero = 0.0 * observation.glucose_mg_dl
        return state + 1.0, Decision(
            insulin_mU_min=zero + self.insulin_mU_min,
            status=jnp.full(zero.shape, int(Status.OK)),
            bolus_mU=jnp.where(state == 0.0, self.bolus_mU, 0.0),
            glucagon_ug=jnp.where(state == self.at, self.glucagon_ug, 0.0),
        )
