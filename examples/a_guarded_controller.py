"""A guard around a controller of your own, and a sensor that gets stuck while a meal raises glucose.

python examples/a_guarded_controller.py
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.plugin import Decision, Observation, Status


@jax.tree_util.register_static
@dataclass(frozen=True)
class Proportional:
    """``u = u_basal + K e``, with the error e = reading - setpoint; it believes everything."""

    gain_mU_min_per_mg_dl: float = 1.0
    sample_time_min: float = 5.0

    def init(self, observation: Observation) -> jax.Array:
        """The basal rate, which the pump has been delivering."""
        return observation.delivered_mU_min

    def step(self, state: jax.Array, observation: Observation):
        """More insulin for more glucose."""
        error = jnp.where(observation.valid, observation.glucose_mg_dl - observation.setpoint_mg_dl, 0.0)
        insulin = state + self.gain_mU_min_per_mg_dl * error
        return state, Decision(insulin_mU_min=insulin, status=jnp.full(insulin.shape, Status.OK))


scenario = gl.Scenario([gl.Meal(60.0, 60.0)], horizon_min=600.0)
sensor = gl.faults.Stuck(
    schedule=gl.faults.once(start_sample=30, samples=36), inner=gl.white_noise(1.45)
)  # from 150 min on, for three hours
for name, controller in {"alone": Proportional(), "guarded": gl.guarded(Proportional())}.items():
    trace = gl.simulate(gl.patient(), controller, sensor, scenario=scenario, key=1)
    metrics = gl.summarise(trace)
    print(f"{name}: glucose down to {float(metrics.minimum_mg_dl):.1f} mg/dl")
