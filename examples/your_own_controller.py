"""A controller of your own, one class: settings, and methods from what is observed to a dose.

glucoloop run --controller 'your_own_controller:YourOwnPI, integral_min=200'
"""

from typing import Annotated

import jax.numpy as jnp

import glucoloop as gl
from glucoloop.plugin import STATIC, About, ControllerComponent, Decision, Observation, Status, wired


class YourOwnPI(ControllerComponent, name="your-own-pi"):
    """``u = u_basal + K (e + integral of e / tau)``, with the error e = reading - setpoint."""

    uses_model = False  # no model is identified for it
    proportional_gain: Annotated[float, About("K, in mU/min per mg/dl.")] = 0.6
    integral_min: Annotated[float, About("Integral time.", above=0.0)] = 150.0
    sample_time_min: float = wired(STATIC, default=5.0)

    def init(self, observation: Observation) -> tuple:
        """The basal rate, which the pump has been delivering, and an integral of nothing."""
        return observation.delivered_mU_min, jnp.zeros_like(observation.delivered_mU_min)

    def step(self, state: tuple, observation: Observation) -> tuple:
        """A missing reading counts as no error."""
        basal, integral = state
        error = jnp.where(observation.valid, observation.glucose_mg_dl - observation.setpoint_mg_dl, 0.0)
        integral = integral + error * self.sample_time_min
        insulin = basal + self.proportional_gain * (error + integral / self.integral_min)
        return (basal, integral), Decision(insulin_mU_min=insulin, status=jnp.full(insulin.shape, Status.OK))


if __name__ == "__main__":
    scenario = gl.Scenario([gl.Meal(40.0, 60.0), gl.Meal(60.0, 420.0)], horizon_min=900.0)
    trace = gl.simulate(gl.patient(), YourOwnPI(), gl.white_noise(1.45), scenario=scenario, key=1)
    print(f"glucose from {gl.summarise(trace).minimum_mg_dl:.1f} to {gl.summarise(trace).peak_mg_dl:.1f} mg/dl")
