"""Events of low glucose, counted as for a continuous sensor.

An event begins when glucose has been below a bound for 15 min, and ends when it has not been for 15 min.

References
----------
T. Battelino et al., "Continuous glucose monitoring and metrics for clinical trials: an international consensus
statement", Lancet Diabetes Endocrinol. 11(1), 2023: level 1 is below 70 mg/dl, level 2 below 54 mg/dl.
"""

from __future__ import annotations

import math
from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.arguments import is_traced
from glucoloop.metrics.protocol import Course, Ended, Metric, count
from glucoloop.simulation.loop import Sampled

BOUNDS_MG_DL: Final = {"low_events": 70.0, "very_low_events": 54.0}
"""Bound of the events of each level, by the name of its result."""
LASTING_MIN: Final = 15.0
_ROUNDING: Final = 1e-4
"""Part of a sample by which rounding of its time, in float32 too, may make more samples of the same minutes."""


@pytree
class _Events:
    """Events counted so far; all arrays have the shape of the people."""

    events: jax.Array
    going: jax.Array
    """Indicator, 1 within an event, else 0."""
    lasting: jax.Array
    """Samples in a row on the side of the bound on which the event, or its absence, would end."""

    def with_sample(self, low: jax.Array, in_a_row: jax.Array | float) -> _Events:
        going = self.going > 0.5
        lasting = jnp.where(low != going, self.lasting + 1.0, 0.0)
        turned = lasting >= in_a_row
        return _Events(
            events=self.events + count(turned & ~going, self.events),
            going=jnp.where(turned, 1.0 - self.going, self.going),
            lasting=jnp.where(turned, 0.0, lasting),
        )


class LowEvents(Metric):
    """Events of both levels, by the name of the result."""

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> dict[str, _Events]:
        """State without events."""
        zero = jnp.zeros_like(glucose_mg_dl)
        return {name: _Events(events=zero, going=zero, lasting=zero) for name in BOUNDS_MG_DL}

    def sample(
        self, course: Course, state: dict[str, _Events], happened: Sampled, t_min: jax.Array
    ) -> dict[str, _Events]:
        """Events with a further sample."""
        in_a_row = samples_in_a_row(course.sample_time_min)
        low = {name: happened.glucose_mg_dl < bound for name, bound in BOUNDS_MG_DL.items()}
        return {name: events.with_sample(low[name], in_a_row) for name, events in state.items()}

    def finish(self, course: Course, state: dict[str, _Events], ended: Ended) -> dict[str, Any]:
        """Number of events of each level."""
        return {name: ended.of_glucose(events.events) for name, events in state.items()}


def samples_in_a_row(sample_time_min: jax.Array | float) -> jax.Array | float:
    """Least number of samples that take 15 min or longer."""
    if is_traced(sample_time_min):
        return jnp.ceil(LASTING_MIN / sample_time_min - _ROUNDING)
    return float(math.ceil(LASTING_MIN / float(sample_time_min) - _ROUNDING))  # native code does not round
