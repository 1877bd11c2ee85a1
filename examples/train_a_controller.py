"""Train controllers by the gradient of what they do: one gain, and a small neural network.

`simulate` can be differentiated, so that a controller's own numbers are found by descent, over several meals and seeds
at once. The network is a module of Equinox, which is a controller like any other.

    python examples/train_a_controller.py [STEPS]
"""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.plugin import Decision, Observation, Status

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 12
PATIENT = gl.patient()
SIZES_G, KEYS = jnp.array([30.0, 70.0]), jax.random.split(jax.random.key(1), 2)


class Policy(eqx.Module):
    """``u = u_basal (1 + network(error, its change, what was given beyond the basal rate))``."""

    network: eqx.nn.MLP
    sample_time_min: float = eqx.field(static=True, default=5.0)

    def init(self, observation: Observation):
        """The basal rate, which the pump has been delivering, and no error yet."""
        return observation.delivered_mU_min, jnp.zeros(())

    def step(self, state, observation: Observation):
        """A missing reading counts as the last one."""
        basal, before = state
        error = jnp.where(observation.valid, observation.glucose_mg_dl - observation.setpoint_mg_dl, before)
        beyond = observation.delivered_mU_min / basal - 1.0
        more = self.network(jnp.stack([error / 50.0, (error - before) / 10.0, beyond]))
        insulin = basal * (1.0 + more)
        return (basal, error), Decision(insulin_mU_min=insulin, status=jnp.asarray(int(Status.OK)))


def cost(controller) -> jax.Array:
    """Mean squared distance from the setpoint, what is below counted four times, over meals and seeds."""

    def one(carbs_g, key):
        scenario = gl.Scenario([gl.Meal(carbs_g, 30.0)], 150.0)
        trace = gl.simulate(PATIENT, controller, gl.white_noise(1.45), scenario=scenario, key=key)
        away = trace.glucose_mg_dl - trace.setpoint_mg_dl
        return jnp.mean(jnp.where(away < 0.0, 4.0, 1.0) * away**2)

    return jnp.mean(jax.vmap(one)(SIZES_G, KEYS))


def trained(controller, rate: float):
    """Descend along the sign of the gradient, in smaller and smaller steps."""
    slope = eqx.filter_jit(eqx.filter_value_and_grad(cost))
    for step in range(STEPS):
        before, gradient = slope(controller)
        if step == 0:
            print(f"    before: {before:.0f} (mg/dl)^2")
        moves = jax.tree.map(lambda g, step=step: -rate * 0.9**step * jnp.sign(g), gradient)
        controller = eqx.apply_updates(controller, moves)
    print(f"    after {STEPS} steps: {slope(controller)[0]:.0f} (mg/dl)^2")
    return controller


print("The gain of a PI controller:")


def pi(gain) -> jax.Array:
    """Cost of a gain."""
    return cost(gl.design_pid(gl.PIDTuning(gain, 300.0)))


gain, slope = 0.3, jax.jit(jax.value_and_grad(pi))
print(f"    before: gain {gain:.2f}, {slope(gain)[0]:.0f} (mg/dl)^2")
for step in range(STEPS):
    gain -= 0.15 * 0.9**step * float(jnp.sign(slope(gain)[1]))
print(f"    after {STEPS} steps: gain {gain:.2f}, {slope(gain)[0]:.0f} (mg/dl)^2")

print("A neural network of 3 inputs and 6 hidden units:")
network = eqx.nn.MLP(3, "scalar", width_size=6, depth=1, activation=jnp.tanh, key=jax.random.key(0))
trained(Policy(network=network), rate=0.1)
