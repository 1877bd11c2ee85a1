"""Regulation of glucose: extremes, settling and squared error, of Parker, Doyle & Peppas 1999, Tables I and II."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.metrics.metric import Ended, Metric, Result, Trajectory

if TYPE_CHECKING:
    from glucoloop.simulation.loop import Sampled

BANDS_PCT: Final = (2, 5)
"""Half widths of the bands, in percent of the setpoint."""
_NEVER: Final = -1.0


@pytree
class _Extreme:
    glucose_mg_dl: jax.Array
    t_min: jax.Array

    def among(self, beyond: jax.Array, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Extreme:
        return _Extreme(
            glucose_mg_dl=jnp.where(beyond, glucose_mg_dl, self.glucose_mg_dl),
            t_min=jnp.where(beyond, t_min, self.t_min),
        )


class Extremes(Metric, name="extremes"):
    """Minimum and maximum glucose.

    Minimum and maximum glucose, each with the time at which it is first reached, and distances from the setpoint.
    """

    section = "Regulation"
    always = True
    numbers = (
        Result("undershoot_mg_dl", "Setpoint minus the minimum glucose.", "Undershoot", "mg/dl", fall=True),
        Result("minimum_mg_dl", "Minimum glucose of the run.", "Minimum glucose", "mg/dl", concentration=True),
        Result(
            "minimum_t_min",
            "Time from the start of the run at which the minimum is first reached.",
            "  at",
            "min",
            0,
            moment=True,
        ),
        Result("overshoot_mg_dl", "Maximum glucose minus the setpoint.", "Overshoot", "mg/dl"),
        Result("peak_mg_dl", "Maximum glucose of the run.", "Maximum glucose", "mg/dl", concentration=True),
        Result(
            "peak_t_min",
            "Time from the start of the run at which the peak is first reached.",
            "  at",
            "min",
            0,
            moment=True,
        ),
    )

    def init(
        self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array
    ) -> tuple[_Extreme, _Extreme]:
        first = _Extreme(glucose_mg_dl=glucose_mg_dl, t_min=jnp.zeros_like(glucose_mg_dl))
        return first, first

    def point(
        self, trajectory: Trajectory, state: tuple[_Extreme, _Extreme], glucose_mg_dl: jax.Array, t_min: jax.Array
    ) -> tuple[_Extreme, _Extreme]:
        least, greatest = state
        return (
            least.among(glucose_mg_dl < least.glucose_mg_dl, glucose_mg_dl, t_min),
            greatest.among(glucose_mg_dl > greatest.glucose_mg_dl, glucose_mg_dl, t_min),
        )

    def finish(self, trajectory: Trajectory, state: tuple[_Extreme, _Extreme], ended: Ended) -> dict[str, Any]:
        least, greatest = state
        return {
            "undershoot_mg_dl": ended.of_glucose(trajectory.setpoint_mg_dl - least.glucose_mg_dl),
            "minimum_mg_dl": ended.of_glucose(least.glucose_mg_dl),
            "minimum_t_min": ended.of_glucose(least.t_min),
            "overshoot_mg_dl": ended.of_glucose(greatest.glucose_mg_dl - trajectory.setpoint_mg_dl),
            "peak_mg_dl": ended.of_glucose(greatest.glucose_mg_dl),
            "peak_t_min": ended.of_glucose(greatest.t_min),
        }


class Settling(Metric, name="settling"):
    """Time until glucose stays near the setpoint.

    Settling time: how long after the meal glucose enters a band around the setpoint for good.

    It is the first point of the grid after the last one with ``|glucose - setpoint| > band / 100 * setpoint``, less the
    time of the meal: on a grid of one minute, the last minute outside, plus 1, less the time of the meal. It is 0 if
    glucose is never outside, or not after the meal. If glucose is outside at the last point it has not settled, and the
    time is that of the point which would follow, less the time of the meal: a lower bound. The state is the last time
    at which glucose was outside each band, negative for never.
    """

    section = "Regulation"
    always = True
    numbers = (
        Result(
            "settling_2pct_min",
            "Last minute farther than 2 % of the setpoint from it, plus 1, minus the time of the first meal, "
            "or of the start if nothing is eaten; 0 if never so far. Where not settled, the horizon plus 1 "
            "takes the place of that minute.",
            "Settling, 2 % band",
            "min",
            0,
            exact_if="settled_2pct",
        ),
        Result("settled_2pct", "Whether glucose is within 2 % of the setpoint at the end."),
        Result(
            "settling_5pct_min",
            "Settling time for a band of 5 % of the setpoint.",
            "Settling, 5 % band",
            "min",
            0,
            exact_if="settled_5pct",
        ),
        Result("settled_5pct", "Whether glucose is within 5 % of the setpoint at the end."),
    )

    def init(
        self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array
    ) -> tuple[jax.Array, ...]:
        return (jnp.zeros_like(glucose_mg_dl) + _NEVER,) * len(BANDS_PCT)

    def point(
        self, trajectory: Trajectory, state: tuple[jax.Array, ...], glucose_mg_dl: jax.Array, t_min: jax.Array
    ) -> tuple[jax.Array, ...]:
        away = jnp.abs(glucose_mg_dl - trajectory.setpoint_mg_dl)
        return tuple(
            jnp.where(away > band / 100.0 * trajectory.setpoint_mg_dl, t_min, last)
            for band, last in zip(BANDS_PCT, state, strict=True)
        )

    def finish(self, trajectory: Trajectory, state: tuple[jax.Array, ...], ended: Ended) -> dict[str, Any]:
        result, xp = {}, ended.xp
        step_min = ended.end_min / (ended.points - 1)
        for band, last in zip(BANDS_PCT, state, strict=True):
            after = xp.where(last < 0.0, 0.0, xp.maximum(last + step_min - ended.first_meal_min, 0.0))
            result[f"settling_{band}pct_min"] = ended.of_glucose(after)
            # outside in the last minute counts as outside at the end
            result[f"settled_{band}pct"] = ended.finite_glucose & ~(last > ended.end_min - step_min / 2.0)
        return result


class SquaredError(Metric, name="squared-error"):
    """Sum of squared errors.

    Sum over samples of ``(glucose - setpoint)^2`` [(mg/dl)^2]; it grows with their number.
    """

    section = "Regulation"
    always = True
    numbers = (
        Result(
            "sse",
            "Sum over the controller's samples of the squared distance from the setpoint [(mg/dl)^2].",
            "Sum of squared errors",
            "(mg/dl)²",
            digits=0,
        ),
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        return jnp.zeros_like(glucose_mg_dl)

    def sample(self, trajectory: Trajectory, state: jax.Array, happened: Sampled, t_min: jax.Array) -> jax.Array:
        error = happened.glucose_mg_dl - trajectory.setpoint_mg_dl
        return state + error * error

    def finish(self, trajectory: Trajectory, state: jax.Array, ended: Ended) -> dict[str, Any]:
        return {"sse": ended.xp.where(ended.xp.isfinite(state), state, ended.xp.nan)}
