"""A fault of your own: a sensor that gives its readings in coarse steps while the fault is present.

Try it with ``glucoloop run --fault 'your_own_fault:Coarse, step_mg_dl=20, start_min=60'``.
"""

import dataclasses
from typing import Annotated

import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.plugin import About, Reading, SensorFault


class Coarse(SensorFault, name="coarse"):
    """Readings are given in coarse steps."""

    step_mg_dl: Annotated[float, About("Step of the readings.", above=0.0)] = 10.0

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """The nearest whole step; ``age`` is the number of samples since the fault began."""
        steps = jnp.round(reading.glucose_mg_dl / self.step_mg_dl)
        return dataclasses.replace(reading, glucose_mg_dl=self.step_mg_dl * steps)


if __name__ == "__main__":
    sensor = Coarse(20.0, inner=gl.white_noise(1.45))
    trace = gl.simulate(gl.patient(), gl.design_pid(gl.internal_model_tuning(-3.45, 89.1, 5.0, 30.0)), sensor, key=1)
    print("readings:", ", ".join(f"{float(mg_dl):g}" for mg_dl in sorted(set(trace.reading_mg_dl.tolist()))), "mg/dl")
