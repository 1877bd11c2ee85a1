"""Mean glucose, its coefficient of variation, and the glucose management indicator.

References
----------
R. M. Bergenstal et al., "Glucose management indicator (GMI): a new term for estimating A1C from continuous glucose
monitoring", Diabetes Care 41(11), 2275-2280, 2018.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.metrics.protocol import Course, Ended, Metric


@pytree
class _Sums:
    """Sums over the grid of glucose less the setpoint, so that little is lost to rounding."""

    deviation: jax.Array
    squared: jax.Array


class MeanAndVariation(Metric):
    """Mean, coefficient of variation with ``n - 1`` as its denominator, and ``GMI = 3.31 + 0.02392 mean``."""

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Sums:
        """Sums of no points."""
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Sums(deviation=zero, squared=zero)

    def point(self, course: Course, state: _Sums, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Sums:
        """Sums with a further point of the grid."""
        deviation = glucose_mg_dl - course.setpoint_mg_dl
        return _Sums(deviation=state.deviation + deviation, squared=state.squared + deviation * deviation)

    def finish(self, course: Course, state: _Sums, ended: Ended) -> dict[str, Any]:
        """Mean, variation and indicator."""
        mean = ended.of_glucose(course.setpoint_mg_dl + state.deviation / ended.points)
        variance = (state.squared - state.deviation**2 / ended.points) / (ended.points - 1)
        deviation = ended.xp.sqrt(ended.xp.maximum(ended.of_glucose(variance), 0.0))
        return {"mean_mg_dl": mean, "cv_pct": 100.0 * deviation / mean, "gmi_pct": 3.31 + 0.02392 * mean}
