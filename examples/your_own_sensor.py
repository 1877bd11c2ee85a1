"""A sensor of your own: glucose reaches it late, as under the skin, and it gives whole steps.

A sensor is a record with `init` and `read`. A part names it with its settings, and makes it known to every command.

    python examples/your_own_sensor.py
    glucoloop run --sensor 'your_own_sensor:LateSteps, lag_min=12' --noise 1.45
"""

import functools
from dataclasses import dataclass
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

import glucoloop as gl
from glucoloop.component import About
from glucoloop.control import internal_model_tuning
from glucoloop.sensors import Reading, SensorPart


@functools.partial(jax.tree_util.register_dataclass, data_fields=["left", "step_mg_dl"], meta_fields=["site"])
@dataclass(frozen=True)
class LateSensor:
    """Reads glucose behind a first-order lag, in whole steps."""

    left: float
    """Share of a difference that is left after a sample."""
    step_mg_dl: float
    site: str | None = None
    """Which glucose of the patient it sees; None is the one that is controlled."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> jax.Array:
        """State of a sensor that has read this glucose for a long time: the glucose behind the lag."""
        del key
        return glucose_mg_dl

    def read(self, state: jax.Array, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[jax.Array, Reading]:
        """Read once per sample; `key` is for random numbers."""
        del key
        behind = glucose_mg_dl + self.left * (state - glucose_mg_dl)
        reading = self.step_mg_dl * jnp.round(behind / self.step_mg_dl)
        return behind, Reading(glucose_mg_dl=reading, valid=jnp.isfinite(reading))


class LateSteps(SensorPart, name="late-steps"):
    """A lag as under the skin, and whole steps."""

    lag_min: Annotated[float, About("Time constant of the lag.", above=0.0)] = 8.0
    step_mg_dl: Annotated[float, About("Step of the readings.", above=0.0)] = 1.0

    def made(self, *, sample_time_min: float, site: str | None = None, **known: object) -> LateSensor:
        """The sensor, for the sample time of the loop and the site that was asked for."""
        return LateSensor(float(np.exp(-sample_time_min / self.lag_min)), self.step_mg_dl, site)


if __name__ == "__main__":
    controller = gl.design_pid(internal_model_tuning(-3.45, 89.1, 5.0, 30.0))
    trace = gl.simulate(gl.patient(), controller, LateSteps().made(sample_time_min=5.0))
    late = float((trace.glucose_mg_dl - trace.reading_mg_dl).max())
    print(f"readings are behind glucose by up to {late:.1f} mg/dl")
