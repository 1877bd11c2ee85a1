"""Settling time: how long after the meal glucose enters a band around the setpoint for good.

It is the first point of the grid after the last one with ``|glucose - setpoint| > band / 100 * setpoint``, less the
time of the meal: on a grid of one minute, the last minute outside, plus 1, less the time of the meal. It is 0 if
glucose is never outside, or not after the meal. If glucose is outside at the last point it has not settled, and the
time is that of the point which would follow, less the time of the meal: a lower bound.

Parker, Doyle & Peppas 1999, Tables I and II.
"""

from __future__ import annotations

from typing import Any, Final

import jax
import jax.numpy as jnp

from glucoloop.metrics.protocol import Course, Ended, Metric

BANDS_PCT: Final = (2, 5)
"""Half widths of the bands, in percent of the setpoint."""
_NEVER: Final = -1.0


class Settling(Metric):
    """Last time at which glucose was outside each band; negative for never."""

    def init(self, course: Course, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> tuple[jax.Array, ...]:
        """State of glucose that was never outside."""
        return (jnp.zeros_like(glucose_mg_dl) + _NEVER,) * len(BANDS_PCT)

    def point(
        self, course: Course, state: tuple[jax.Array, ...], glucose_mg_dl: jax.Array, t_min: jax.Array
    ) -> tuple[jax.Array, ...]:
        """Last times with a further point of the grid."""
        away = jnp.abs(glucose_mg_dl - course.setpoint_mg_dl)
        return tuple(
            jnp.where(away > band / 100.0 * course.setpoint_mg_dl, t_min, last)
            for band, last in zip(BANDS_PCT, state, strict=True)
        )

    def finish(self, course: Course, state: tuple[jax.Array, ...], ended: Ended) -> dict[str, Any]:
        """Settling time, and whether it is one, for each band."""
        found, xp = {}, ended.xp
        step_min = ended.end_min / (ended.points - 1)
        for band, last in zip(BANDS_PCT, state, strict=True):
            after = xp.where(last < 0.0, 0.0, xp.maximum(last + step_min - ended.first_meal_min, 0.0))
            found[f"settling_{band}pct_min"] = ended.of_glucose(after)
            # outside in the last minute counts as outside at the end
            found[f"settled_{band}pct"] = ended.finite_glucose & ~(last > ended.end_min - step_min / 2.0)
        return found
