"""A controller of your own

Proportional-integral control in twenty lines, on two meals with a noisy sensor.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.control import Decision, Observation, Status


@jax.tree_util.register_static
@dataclass(frozen=True)
class ProportionalIntegral:
    gain_mU_min_per_mg_dl: float = 0.6
    integral_time_min: float = 150.0
    sample_time_min: float = 5.0

    def init(self, observation: Observation):
        return observation.delivered_mU_min, jnp.zeros_like(observation.delivered_mU_min)

    def step(self, state, observation: Observation):
        basal, integral = state
        error = jnp.where(observation.valid, observation.glucose_mg_dl - observation.setpoint_mg_dl, 0.0)
        integral = integral + error * self.sample_time_min
        insulin = basal + self.gain_mU_min_per_mg_dl * (error + integral / self.integral_time_min)
        return (basal, integral), Decision(insulin_mU_min=insulin, status=jnp.full(insulin.shape, Status.OK))


scenario = gl.Scenario([gl.Meal(40.0, 60.0), gl.Meal(60.0, 420.0)], horizon_min=900.0)
trace = gl.simulate(gl.patient(), ProportionalIntegral(), gl.white_noise(1.45), scenario=scenario, key=1)
metrics = gl.summarise(trace)

print(f"glucose from {metrics.minimum_mg_dl:.1f} to {metrics.peak_mg_dl:.1f} mg/dl")
figure = gl.plot(trace)
