"""A controller of your own: proportional-integral control, written against `glucoloop.control.Controller`.

A controller is a pure function of its state and of what it observes. The two lines above the class let JAX carry it
through the loop as a constant. `simulate` takes it as it is; its part makes it known to every command.

    python examples/your_own_controller.py
    glucoloop run --controller 'your_own_controller:YourOwnPI, integral_min=200'
"""

from dataclasses import dataclass
from typing import Annotated

import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.component import About
from glucoloop.control import ControllerPart, Decision, Observation, Status
from glucoloop.control.design_case import DesignCase


@jax.tree_util.register_static
@dataclass(frozen=True)
class ProportionalIntegral:
    """``u = u_basal + K (e + integral of e / tau)``, with the error e = reading - setpoint."""

    gain_mU_min_per_mg_dl: float = 0.6
    integral_time_min: float = 150.0
    sample_time_min: float = 5.0

    def init(self, observation: Observation) -> tuple[jax.Array, jax.Array]:
        """The basal rate, which the pump has been delivering, and an integral of nothing."""
        return observation.delivered_mU_min, jnp.zeros_like(observation.delivered_mU_min)

    def step(self, state: tuple[jax.Array, jax.Array], observation: Observation):
        """A missing reading counts as no error."""
        basal, integral = state
        error = jnp.where(observation.valid, observation.glucose_mg_dl - observation.setpoint_mg_dl, 0.0)
        integral = integral + error * self.sample_time_min
        insulin = basal + self.gain_mU_min_per_mg_dl * (error + integral / self.integral_time_min)
        return (basal, integral), Decision(insulin_mU_min=insulin, status=jnp.full(insulin.shape, Status.OK))


class YourOwnPI(ControllerPart, name="your-own-pi"):
    """Proportional-integral control."""

    uses_model = False  # no model is identified for it
    proportional_gain: Annotated[float, About("K, in mU/min per mg/dl.")] = 0.6
    integral_min: Annotated[float, About("Integral time.", above=0.0)] = 150.0

    def designed(self, case: DesignCase) -> ProportionalIntegral:
        """The controller for a situation: `case` has models of the patient, the limits of the pump and the noise.

        What is not possible is refused here, since `step` cannot raise.
        """
        return ProportionalIntegral(self.proportional_gain, self.integral_min, case.sample_time_min)


if __name__ == "__main__":
    scenario = gl.Scenario([gl.Meal(40.0, 60.0), gl.Meal(60.0, 420.0)], horizon_min=900.0)
    trace = gl.simulate(gl.patient(), ProportionalIntegral(), gl.white_noise(1.45), scenario=scenario, key=1)
    metrics = gl.summarise(trace)
    print(f"glucose from {float(metrics.minimum_mg_dl):.1f} to {float(metrics.peak_mg_dl):.1f} mg/dl")
