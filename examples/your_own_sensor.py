"""A sensor of your own: glucose reaches it late, as subcutaneous glucose does, and it gives whole steps.

Try it with ``glucoloop run --sensor 'your_own_sensor:LateSteps, lag_min=12' --noise 1.45``.
"""

from typing import Annotated

import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.plugin import STATIC, About, Reading, SensorComponent, wired


class LateSteps(SensorComponent, name="late-steps"):
    """A lag as under the skin, and whole steps."""

    lag_min: Annotated[float, About("Time constant of the lag.", above=0.0)] = 8.0
    step_mg_dl: Annotated[float, About("Step of the readings.", above=0.0)] = 1.0
    sample_time_min: float = wired(STATIC, default=5.0)
    site: str | None = wired(STATIC, default=None)  # which glucose of the patient it sees; None: what is controlled

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> jax.Array:
        """State of a sensor that has read this glucose for a long time: the glucose behind the lag."""
        return glucose_mg_dl

    def read(self, state: jax.Array, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[jax.Array, Reading]:
        """Read once per sample; ``key`` is for random numbers."""
        behind = glucose_mg_dl + jnp.exp(-self.sample_time_min / self.lag_min) * (state - glucose_mg_dl)
        steps = self.step_mg_dl * jnp.round(behind / self.step_mg_dl)
        return behind, Reading(glucose_mg_dl=steps, valid=jnp.isfinite(steps))


if __name__ == "__main__":
    trace = gl.simulate(gl.patient(), gl.design_pid(gl.internal_model_tuning(-3.45, 89.1, 5.0, 30.0)), LateSteps(8.0))
    print(f"readings are behind glucose by up to {(trace.glucose_mg_dl - trace.reading_mg_dl).max():.1f} mg/dl")
