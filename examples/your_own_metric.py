"""A metric of your own: the time from 70 to 140 mg/dl.

A metric is a fold: a state before the run, the state after each point of its grid of one minute or after each sample,
and the results. Its entry, at the end, says how they are shown, and makes the metric known to runs and trials.

    python examples/your_own_metric.py
    glucoloop run --metric your_own_metric:ENTRY
    glucoloop trial --metric your_own_metric:ENTRY --people 200 --out people
"""

from typing import Any

import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.control import internal_model_tuning
from glucoloop.metrics import Course, Ended, Metric
from glucoloop.registry.metrics import MetricEntry, Result


class TightRange(Metric):
    """Counts the points of the grid at which glucose is from 70 to 140 mg/dl."""

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Number of points before the run."""
        return jnp.zeros_like(glucose_mg_dl)

    def point(self, course: Course, state: jax.Array, glucose_mg_dl: jax.Array, t_min: jax.Array) -> jax.Array:
        """Number with a further point."""
        return state + ((glucose_mg_dl >= 70.0) & (glucose_mg_dl <= 140.0)).astype(state.dtype)

    def finish(self, course: Course, state: jax.Array, ended: Ended) -> dict[str, Any]:
        """Share of the points; NaN where glucose was not finite."""
        return {"time_70_140_pct": ended.pct(state)}


ENTRY = MetricEntry(
    name="tight-range",
    summary="time in the tight range",
    fold="your_own_metric:TightRange",
    results=(
        Result(
            "time_70_140_pct",
            "Percentage of time with glucose from 70 to 140 mg/dl.",
            title="Time from 70 to 140 mg/dl",
            unit="%",
        ),
    ),
)

if __name__ == "__main__":
    trace = gl.simulate(gl.patient(), gl.design_pid(internal_model_tuning(-3.45, 89.1, 5.0, 30.0)))
    metrics = gl.summarise(trace, metrics=["your_own_metric:ENTRY"])
    print(f"time from 70 to 140 mg/dl: {float(metrics.time_70_140_pct):.1f} %")
