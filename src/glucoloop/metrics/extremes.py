"""Least and greatest glucose, each with the time at which it is first reached.

Parker, Doyle & Peppas 1999, Tables I and II.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.metrics.protocol import Course, Ended, Metric


@pytree
class _Extreme:
    glucose_mg_dl: jax.Array
    t_min: jax.Array

    def among(self, beyond: jax.Array, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Extreme:
        return _Extreme(
            glucose_mg_dl=jnp.where(beyond, glucose_mg_dl, self.glucose_mg_dl),
            t_min=jnp.where(beyond, t_min, self.t_min),
        )


class Extremes(Metric):
    """Least and greatest glucose, and their distances from the setpoint."""

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> tuple[_Extreme, _Extreme]:
        """Glucose at the start as both extremes."""
        first = _Extreme(glucose_mg_dl=glucose_mg_dl, t_min=jnp.zeros_like(glucose_mg_dl))
        return first, first

    def point(
        self, course: Course, state: tuple[_Extreme, _Extreme], glucose_mg_dl: jax.Array, t_min: jax.Array
    ) -> tuple[_Extreme, _Extreme]:
        """Extremes with a further point of the grid."""
        least, greatest = state
        return (
            least.among(glucose_mg_dl < least.glucose_mg_dl, glucose_mg_dl, t_min),
            greatest.among(glucose_mg_dl > greatest.glucose_mg_dl, glucose_mg_dl, t_min),
        )

    def finish(self, course: Course, state: tuple[_Extreme, _Extreme], ended: Ended) -> dict[str, Any]:
        """Extremes and their distances from the setpoint."""
        least, greatest = state
        return {
            "undershoot_mg_dl": ended.of_glucose(course.setpoint_mg_dl - least.glucose_mg_dl),
            "minimum_mg_dl": ended.of_glucose(least.glucose_mg_dl),
            "minimum_t_min": ended.of_glucose(least.t_min),
            "overshoot_mg_dl": ended.of_glucose(greatest.glucose_mg_dl - course.setpoint_mg_dl),
            "peak_mg_dl": ended.of_glucose(greatest.glucose_mg_dl),
            "peak_t_min": ended.of_glucose(greatest.t_min),
        }
