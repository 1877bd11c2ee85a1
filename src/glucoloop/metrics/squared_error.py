"""Sum of squared errors: Parker, Doyle & Peppas 1999, Tables I and II."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop.metrics.protocol import Course, Ended, Metric
from glucoloop.simulation.loop import Sampled


class SquaredError(Metric):
    """Sum over samples of ``(glucose - setpoint)^2`` [(mg/dl)^2]; it grows with their number."""

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Sum of no samples."""
        return jnp.zeros_like(glucose_mg_dl)

    def sample(self, course: Course, state: jax.Array, happened: Sampled, t_min: jax.Array) -> jax.Array:
        """Sum with a further sample."""
        error = happened.glucose_mg_dl - course.setpoint_mg_dl
        return state + error * error

    def finish(self, course: Course, state: jax.Array, ended: Ended) -> dict[str, Any]:
        """Sum over the run."""
        return {"sse": ended.xp.where(ended.xp.isfinite(state), state, ended.xp.nan)}
