"""Insulin delivered over a run, and how much its rate changes."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.metrics.protocol import Course, Ended, Metric
from glucoloop.simulation.loop import Sampled


@pytree
class _Doses:
    total: jax.Array
    """Sum over the samples of the delivered insulin, boluses included; the others are of the basal rate alone."""
    variation: jax.Array
    largest_change: jax.Array
    previous_mU_min: jax.Array


class Insulin(Metric):
    """Total insulin, boluses included, and the changes of the rate, the first from the rate at rest."""

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Doses:
        """State before the first dose, with the rate at rest."""
        del course
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Doses(total=zero, variation=zero, largest_change=zero, previous_mU_min=insulin_mU_min)

    def sample(self, course: Course, state: _Doses, happened: Sampled, t_min: jax.Array) -> _Doses:
        """Doses with a further sample."""
        del course, t_min
        rate = happened.delivery.insulin_mU_min
        change = jnp.abs(rate - state.previous_mU_min)
        return _Doses(
            total=state.total + happened.infused_mU_min,
            variation=state.variation + change,
            largest_change=jnp.maximum(state.largest_change, change),
            previous_mU_min=rate,
        )

    def finish(self, course: Course, state: _Doses, ended: Ended) -> dict[str, Any]:
        """Total and changes over the run."""
        del course
        return {
            "insulin_total_mU": ended.of_insulin(state.total * ended.sample_time_min),
            "insulin_total_variation_mU_min": ended.of_insulin(state.variation),
            "largest_change_mU_min": ended.of_insulin(state.largest_change),
        }
