"""Linear MPC that is led by a row of readings, with the pump of the paper."""

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.pumps import LimitedPump, dose_limits
from observing import observing

# Second order: a slow fall of glucose after a delayed start.
IMPULSE = -0.12 * (np.exp(-np.arange(1, 37) / 9.0) - np.exp(-np.arange(1, 37) / 3.0))
WIDE = dose_limits(max_change_mU_min=1e6, max_mU_min=1e6)
observe = observing(setpoint=81.1)


@jax.jit
def follow(controller, readings, valid, start):
    """Doses, commands and states of a controller and the pump over a row of readings."""
    pump = LimitedPump(limits=controller.plan.limits)

    def sample(carry, entry):
        state, delivered = carry
        state, decision = controller.step(state, observe(entry[0], delivered, valid=entry[1]))
        delivered, _ = pump.deliver(delivered, decision.insulin_mU_min, jax.random.key(0))
        return (state, delivered), (delivered, decision, state)

    first = (controller.init(observe(readings[0], start, valid=valid[0])), jnp.asarray(start))
    return jax.lax.scan(sample, first, (readings, valid))[1]
