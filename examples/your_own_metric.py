"""A metric of your own: the time in a narrow range of glucose.

A metric is a fold: a state before the run, the state after each point of its grid of one minute or after each sample,
and the results. Its part says how they are shown, and makes the metric known to runs and trials.

    python examples/your_own_metric.py
    glucoloop run --metric 'your_own_metric:TightRange, low_mg_dl=63'
    glucoloop trial --metric your_own_metric:TightRange --people 200 --out people
"""

from dataclasses import dataclass
from typing import Annotated, Any

import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.component import About
from glucoloop.control import internal_model_tuning
from glucoloop.metrics import Ended, Metric, MetricPart, Result, Trajectory


@dataclass(frozen=True)
class PointsInRange(Metric):
    """Counts the points of the grid at which glucose is within a range."""

    low_mg_dl: int
    high_mg_dl: int

    def init(self, course: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Number of points before the run."""
        return jnp.zeros_like(glucose_mg_dl)

    def point(self, course: Trajectory, state: jax.Array, glucose_mg_dl: jax.Array, t_min: jax.Array) -> jax.Array:
        """Number with a further point."""
        within = (glucose_mg_dl >= self.low_mg_dl) & (glucose_mg_dl <= self.high_mg_dl)
        return state + within.astype(state.dtype)

    def finish(self, course: Trajectory, state: jax.Array, ended: Ended) -> dict[str, Any]:
        """Share of the points; NaN where glucose was not finite."""
        return {f"time_{self.low_mg_dl}_{self.high_mg_dl}_pct": ended.pct(state)}


class TightRange(MetricPart, name="tight-range"):
    """Time in a narrow range."""

    low_mg_dl: Annotated[int, About("Lower end of the range.", at_least=0)] = 70
    high_mg_dl: Annotated[int, About("Upper end of the range.", at_least=0)] = 140

    @property
    def results(self) -> tuple[Result, ...]:
        """Names and texts of the results; a metric without settings has a tuple ``numbers`` in place of this."""
        within = f"from {self.low_mg_dl} to {self.high_mg_dl} mg/dl"
        name, summary = f"time_{self.low_mg_dl}_{self.high_mg_dl}_pct", f"Percentage of time with glucose {within}."
        return (Result(name, summary, title=f"Time {within}", unit="%"),)

    def made(self, **known: object) -> PointsInRange:
        """The fold that computes them."""
        return PointsInRange(self.low_mg_dl, self.high_mg_dl)


if __name__ == "__main__":
    trace = gl.simulate(gl.patient(), gl.design_pid(internal_model_tuning(-3.45, 89.1, 5.0, 30.0)))
    metrics = gl.summarise(trace, metrics=["your_own_metric:TightRange"])
    print(f"time from 70 to 140 mg/dl: {float(metrics.time_70_140_pct):.1f} %")
