"""Times in ranges of glucose, as diabetes care reports them, and the risk index that follows from them.

A time is the percentage of the points of the grid of one minute, both ends included.

References
----------
T. Battelino et al., "Clinical targets for continuous glucose monitoring data interpretation: recommendations from the
international consensus on time in range", Diabetes Care 42(8), 1593-1603, 2019.
D. C. Klonoff et al., "A glycemia risk index (GRI) of hypoglycemia and hyperglycemia for continuous glucose monitoring
validated by clinician ratings", J. Diabetes Sci. Technol. 17(5), 1226-1242, 2023.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree
from glucoloop.metrics.protocol import Course, Ended, Metric, count
from glucoloop.simulation.loop import Sampled


@pytree
class _Points:
    """Numbers of points of the grid."""

    below_54: jax.Array
    below_60: jax.Array
    below_70: jax.Array
    below_validity: jax.Array
    above_180: jax.Array
    above_250: jax.Array


class TimeInRanges(Metric):
    """Times in ranges, and the glycemia risk index ``min(100, 3 VLow + 2.4 Low + 1.6 VHigh + .8 High)``.

    VLow, Low, High, VHigh are the percentages of points below 54, from 54 to below 70, above 180 to 250, and above
    250 mg/dl.
    """

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Points:
        """Numbers before the first point."""
        return _Points(**{field.name: jnp.zeros_like(glucose_mg_dl) for field in dataclasses.fields(_Points)})

    def point(self, course: Course, state: _Points, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Points:
        """Numbers with a further point of the grid."""
        g = glucose_mg_dl
        return dataclasses.replace(
            state,
            below_54=state.below_54 + count(g < 54.0, g),
            below_60=state.below_60 + count(g < 60.0, g),
            below_70=state.below_70 + count(g < 70.0, g),
            above_180=state.above_180 + count(g > 180.0, g),
            above_250=state.above_250 + count(g > 250.0, g),
        )

    def sample(self, course: Course, state: _Points, happened: Sampled, t_min: jax.Array) -> _Points:
        """Numbers with the points that follow a sample, below the valid range of the model at that sample."""
        g, lowest = happened.glucose_mg_dl, happened.lowest_valid_mg_dl
        # The first point of the grid is the first sample; the others lie after a sample.
        below = count((t_min <= 0.0) & (g < lowest), g)
        for place in range(len(course.inside_min)):
            below = below + count(happened.inside_mg_dl[place] < lowest, g)
        return dataclasses.replace(state, below_validity=state.below_validity + below)

    def finish(self, course: Course, state: _Points, ended: Ended) -> dict[str, Any]:
        """Percentages of the points, and the risk index."""
        very_low, very_high = ended.pct(state.below_54), ended.pct(state.above_250)
        below, above = ended.pct(state.below_70), ended.pct(state.above_180)
        risk = 3.0 * very_low + 2.4 * (below - very_low) + 1.6 * very_high + 0.8 * (above - very_high)
        return {
            "time_below_54_pct": very_low,
            "time_below_60_pct": ended.pct(state.below_60),
            "time_below_70_pct": below,
            "time_below_validity_pct": ended.pct(state.below_validity),
            "time_70_180_pct": ended.pct(ended.points - state.below_70 - state.above_180),
            "time_above_180_pct": above,
            "time_above_250_pct": very_high,
            "gri": ended.xp.minimum(risk, 100.0),
        }
