"""A metric of your own: the time in a narrow range of glucose.

python examples/your_own_metric.py
glucoloop run --metric 'your_own_metric:TightRange, low_mg_dl=63'
"""

from typing import Annotated

import jax.numpy as jnp

import glucoloop as gl
from glucoloop.plugin import About, Metric, Result


class TightRange(Metric, name="tight-range"):
    """Time in a narrow range."""

    low_mg_dl: Annotated[int, About("Lower end of the range.", at_least=0)] = 70
    high_mg_dl: Annotated[int, About("Upper end of the range.", at_least=0)] = 140

    @property
    def results(self):
        low, high = self.low_mg_dl, self.high_mg_dl
        return (Result(f"time_{low}_{high}_pct", "Time in the range.", f"Time from {low} to {high} mg/dl", "%"),)

    def init(self, trajectory, glucose_mg_dl, insulin_mU_min):
        return jnp.zeros_like(glucose_mg_dl)

    def point(self, trajectory, state, glucose_mg_dl, t_min):
        return state + ((glucose_mg_dl >= self.low_mg_dl) & (glucose_mg_dl <= self.high_mg_dl))

    def finish(self, trajectory, state, ended):
        return {self.results[0].name: ended.pct(state)}


if __name__ == "__main__":
    trace = gl.simulate(gl.patient(), gl.design_pid(gl.internal_model_tuning(-3.45, 89.1, 5.0, 30.0)))
    metrics = gl.summarise(trace, metrics=["your_own_metric:TightRange"])
    print(f"time from 70 to 140 mg/dl: {metrics.time_70_140_pct:.1f} %")
