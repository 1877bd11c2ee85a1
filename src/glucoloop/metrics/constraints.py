"""Constraints (17) to (19) of Parker, Doyle & Peppas 1999 on the delivered insulin and on glucose."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.metrics.protocol import Course, Ended, Metric
from glucoloop.simulation.loop import Sampled


@pytree
class _Extremes:
    """Extremes of what the constraints bound."""

    largest_change: jax.Array
    previous_mU_min: jax.Array
    lowest_mU_min: jax.Array
    highest_mU_min: jax.Array
    minimum_mg_dl: jax.Array


class Constraints(Metric):
    """Whether the rate and its changes stay within the pump's limits, and glucose above its bound.

    Values that are not finite violate every constraint. The first change is that from the rate at rest.
    """

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Extremes:
        """Extremes of no samples."""
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Extremes(
            largest_change=zero,
            previous_mU_min=insulin_mU_min,
            lowest_mU_min=zero + jnp.inf,
            highest_mU_min=zero - jnp.inf,
            minimum_mg_dl=glucose_mg_dl,
        )

    def point(self, course: Course, state: _Extremes, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Extremes:
        """Extremes with a further point of the grid."""
        return dataclasses.replace(state, minimum_mg_dl=jnp.minimum(state.minimum_mg_dl, glucose_mg_dl))

    def sample(self, course: Course, state: _Extremes, happened: Sampled, t_min: jax.Array) -> _Extremes:
        """Extremes with a further sample."""
        rate = happened.delivery.insulin_mU_min
        return dataclasses.replace(
            state,
            largest_change=jnp.maximum(state.largest_change, jnp.abs(rate - state.previous_mU_min)),
            previous_mU_min=rate,
            lowest_mU_min=jnp.minimum(state.lowest_mU_min, rate),
            highest_mU_min=jnp.maximum(state.highest_mU_min, rate),
        )

    def finish(self, course: Course, state: _Extremes, ended: Ended) -> dict[str, Any]:
        """Whether each constraint holds, and whether all do."""
        slack, limits = ended.rounding_mU_min, course.limits
        rate = ended.finite_insulin & (state.largest_change <= limits.max_change_mU_min + slack)
        magnitude = (
            ended.finite_insulin
            & (state.lowest_mU_min >= limits.min_mU_min - slack)
            & (state.highest_mU_min <= limits.max_mU_min + slack)
        )
        glucose = ended.finite_glucose & (state.minimum_mg_dl >= course.lowest_glucose_mg_dl)
        return {
            "rate_satisfied": rate,
            "magnitude_satisfied": magnitude,
            "glucose_satisfied": glucose,
            "constraints_satisfied": rate & magnitude & glucose,
        }
