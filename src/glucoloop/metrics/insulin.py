"""Insulin delivered over a run, how long there was none, and how much its rate changes."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.metrics.protocol import Course, Ended, Metric, count
from glucoloop.simulation.loop import Sampled


@pytree
class _Doses:
    total: jax.Array
    """Sum over the samples of the delivered insulin, boluses included; the others are of the basal rate alone."""
    variation: jax.Array
    largest_change: jax.Array
    previous_mU_min: jax.Array
    off: jax.Array
    """Number of samples without any insulin."""
    off_in_a_row: jax.Array
    """Number of them up to this sample, without one with insulin between them."""
    most_off_in_a_row: jax.Array


class Insulin(Metric):
    """Total insulin, boluses included, the time without any, and the changes of the rate, the first from rest."""

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Doses:
        """State before the first dose, with the rate at rest."""
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Doses(
            total=zero,
            variation=zero,
            largest_change=zero,
            previous_mU_min=insulin_mU_min,
            off=zero,
            off_in_a_row=zero,
            most_off_in_a_row=zero,
        )

    def sample(self, course: Course, state: _Doses, happened: Sampled, t_min: jax.Array) -> _Doses:
        """Doses with a further sample."""
        rate = happened.delivery.insulin_mU_min
        change = jnp.abs(rate - state.previous_mU_min)
        off = count(happened.infused_mU_min <= 0.0, state.off)
        in_a_row = off * (state.off_in_a_row + 1.0)
        return _Doses(
            total=state.total + happened.infused_mU_min,
            variation=state.variation + change,
            largest_change=jnp.maximum(state.largest_change, change),
            previous_mU_min=rate,
            off=state.off + off,
            off_in_a_row=in_a_row,
            most_off_in_a_row=jnp.maximum(state.most_off_in_a_row, in_a_row),
        )

    def finish(self, course: Course, state: _Doses, ended: Ended) -> dict[str, Any]:
        """Total, time without insulin, and changes over the run."""
        return {
            "insulin_total_mU": ended.of_insulin(state.total * ended.sample_time_min),
            "insulin_off_min": ended.of_insulin(state.off * ended.sample_time_min),
            "longest_insulin_off_min": ended.of_insulin(state.most_off_in_a_row * ended.sample_time_min),
            "insulin_total_variation_mU_min": ended.of_insulin(state.variation),
            "largest_change_mU_min": ended.of_insulin(state.largest_change),
        }
