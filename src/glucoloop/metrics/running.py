"""Metrics computed during the loop: those of `summarise`, sample by sample and without a trace."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop.control.protocol import Status
from glucoloop.metrics import constraints, glycemic
from glucoloop.metrics.low_events import LEVEL_1_MG_DL, LEVEL_2_MG_DL, LowEvents, samples_in_a_row
from glucoloop.metrics.summary import Metrics
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.simulation.loop import Sampled

Floats = npt.NDArray[Any]

_NEVER: Final = -1.0
_ROUNDING_MU_MIN: Final = {"float64": constraints.ROUNDING_MU_MIN, "float32": 1e-4}


@pytree
class Tally:
    """Counts and sums so far, of one person or of many."""

    minimum_mg_dl: jax.Array
    minimum_t_min: jax.Array
    peak_mg_dl: jax.Array
    peak_t_min: jax.Array
    outside_2pct_t_min: jax.Array
    """Last time at which glucose was farther than 2 % from the setpoint; negative for never."""
    outside_5pct_t_min: jax.Array
    sse: jax.Array
    below_54: jax.Array
    """Number of points of the grid below 54 mg/dl."""
    below_60: jax.Array
    below_70: jax.Array
    below_validity: jax.Array
    above_180: jax.Array
    above_250: jax.Array
    deviation: jax.Array
    """Sum over the grid of glucose less the setpoint, so that little is lost to rounding."""
    squared_deviation: jax.Array
    low_risk: jax.Array
    high_risk: jax.Array
    insulin: jax.Array
    """Sum of the delivered insulin over the samples, boluses included; the fields below are of the basal rate alone."""
    variation: jax.Array
    largest_change: jax.Array
    previous_mU_min: jax.Array
    lowest_mU_min: jax.Array
    highest_mU_min: jax.Array
    saturated: jax.Array
    missing: jax.Array
    not_converged: jax.Array
    non_finite: jax.Array
    rejected: jax.Array
    fallback: jax.Array
    suspended: jax.Array
    dose_limited: jax.Array
    low: LowEvents
    very_low: LowEvents


@pytree
class RunningMetrics:
    """Fold of the loop that counts metrics; implements `simulation.cohort.Fold`."""

    setpoint_mg_dl: jax.Array | float
    limits: DoseLimits = PARKER_1999_LIMITS
    lowest_glucose_mg_dl: jax.Array | float = constraints.LOWEST_GLUCOSE_MG_DL
    inside_min: tuple[float, ...] = static()
    """Moments of the fine grid between samples; see `SampleGrid.inside_min`."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> Tally:
        """Counts at the start, which is the first point of the grid."""
        zero = jnp.zeros_like(glucose_mg_dl)
        start = Tally(
            minimum_mg_dl=glucose_mg_dl,
            minimum_t_min=zero,
            peak_mg_dl=glucose_mg_dl,
            peak_t_min=zero,
            **{name: zero + _NEVER for name in ("outside_2pct_t_min", "outside_5pct_t_min")},
            **{name: zero for name in _SUMS},
            low=LowEvents.none(zero),
            very_low=LowEvents.none(zero),
            previous_mU_min=insulin_mU_min,
            lowest_mU_min=zero + jnp.inf,
            highest_mU_min=zero - jnp.inf,
        )
        return self._point(start, glucose_mg_dl, zero)

    def step(self, tally: Tally, happened: Sampled, t_min: jax.Array) -> Tally:
        """Include a sample and the grid until the next."""
        error = happened.glucose_mg_dl - self.setpoint_mg_dl
        insulin, status = happened.delivery.insulin_mU_min, happened.decision.status
        known = happened.reading.valid & jnp.isfinite(happened.reading.glucose_mg_dl)
        change = jnp.abs(insulin - tally.previous_mU_min)
        in_a_row = samples_in_a_row(self.inside_min[-1])
        lowest = happened.lowest_valid_mg_dl

        def count(condition: jax.Array) -> jax.Array:
            return condition.astype(insulin.dtype)

        # The first point of the grid is the first sample; the others lie after a sample.
        beyond = count((t_min <= 0.0) & (happened.glucose_mg_dl < lowest))
        for place in range(len(self.inside_min)):
            beyond = beyond + count(happened.inside_mg_dl[place] < lowest)

        tally = dataclasses.replace(
            tally,
            sse=tally.sse + error * error,
            insulin=tally.insulin + happened.infused_mU_min,
            variation=tally.variation + change,
            largest_change=jnp.maximum(tally.largest_change, change),
            previous_mU_min=insulin,
            lowest_mU_min=jnp.minimum(tally.lowest_mU_min, insulin),
            highest_mU_min=jnp.maximum(tally.highest_mU_min, insulin),
            saturated=tally.saturated + count(status == Status.SATURATED),
            missing=tally.missing + count(~known),
            not_converged=tally.not_converged + count(status == Status.NOT_CONVERGED),
            non_finite=tally.non_finite
            + count((status == Status.NON_FINITE) | (status == Status.RESTARTED) | (status == Status.NO_FINITE_DOSE)),
            rejected=tally.rejected + count(status == Status.READING_REJECTED),
            fallback=tally.fallback + count((status == Status.FALLBACK_BASAL) | (status == Status.FALLBACK_REDUCED)),
            suspended=tally.suspended + count(status == Status.SUSPENDED),
            dose_limited=tally.dose_limited + count(status == Status.DOSE_LIMITED),
            below_validity=tally.below_validity + beyond,
            low=tally.low.step(happened.glucose_mg_dl, LEVEL_1_MG_DL, in_a_row),
            very_low=tally.very_low.step(happened.glucose_mg_dl, LEVEL_2_MG_DL, in_a_row),
        )
        for place, after in enumerate(self.inside_min):
            tally = self._point(tally, happened.inside_mg_dl[place], t_min + after)
        return tally

    def _point(self, tally: Tally, glucose: jax.Array, t_min: jax.Array) -> Tally:
        deviation = glucose - self.setpoint_mg_dl
        away = jnp.abs(deviation)
        lower, higher = glucose < tally.minimum_mg_dl, glucose > tally.peak_mg_dl
        low_risk, high_risk = glycemic.risks(glucose)

        def last(so_far: jax.Array, band_pct: float) -> jax.Array:
            return jnp.where(away > band_pct / 100.0 * self.setpoint_mg_dl, t_min, so_far)

        def count(condition: jax.Array) -> jax.Array:
            return condition.astype(glucose.dtype)

        return dataclasses.replace(
            tally,
            minimum_mg_dl=jnp.where(lower, glucose, tally.minimum_mg_dl),
            minimum_t_min=jnp.where(lower, t_min, tally.minimum_t_min),
            peak_mg_dl=jnp.where(higher, glucose, tally.peak_mg_dl),
            peak_t_min=jnp.where(higher, t_min, tally.peak_t_min),
            outside_2pct_t_min=last(tally.outside_2pct_t_min, 2.0),
            outside_5pct_t_min=last(tally.outside_5pct_t_min, 5.0),
            below_54=tally.below_54 + count(glucose < 54.0),
            below_60=tally.below_60 + count(glucose < 60.0),
            below_70=tally.below_70 + count(glucose < 70.0),
            above_180=tally.above_180 + count(glucose > 180.0),
            above_250=tally.above_250 + count(glucose > 250.0),
            deviation=tally.deviation + deviation,
            squared_deviation=tally.squared_deviation + deviation * deviation,
            low_risk=tally.low_risk + low_risk,
            high_risk=tally.high_risk + high_risk,
        )

    def finish(
        self,
        tally: Tally,
        *,
        samples: int,
        sample_time_min: float,
        meal_t_min: Floats | float,
        precision: str = "float64",
    ) -> Metrics:
        """Metrics of a run.

        Parameters
        ----------
        tally : Tally
            Counts ``(people,)`` each, float64.
        samples : int
        sample_time_min : float
        meal_t_min : () or (people,) array
            Time of the sample in which the first meal begins; 0 if nothing is eaten.
        precision : {"float64", "float32"}
            Precision of the tally: a dose at its limit may seem to exceed it by rounding.

        Returns
        -------
        Metrics
            NumPy arrays ``(people,)``; as `summarise` has them, NaN for a person whose glucose was not finite.
        """
        t = jax.tree.map(lambda a: np.asarray(a, np.float64), tally)
        setpoint = np.asarray(self.setpoint_mg_dl, np.float64)
        points = samples * len(self.inside_min) + 1
        end, minute = samples * sample_time_min, sample_time_min / len(self.inside_min)
        sound = np.isfinite(t.squared_deviation) & np.isfinite(t.minimum_mg_dl) & np.isfinite(t.peak_mg_dl)
        delivered = np.isfinite(t.insulin) & np.isfinite(t.variation)

        def of(values: Floats, holds: Floats = sound) -> Any:
            return np.where(holds, values, np.nan)

        def settled(last: Floats) -> tuple[Any, Any]:
            # in the last minute counts as at the end
            after = np.where(last < 0.0, 0.0, np.maximum(last + minute - meal_t_min, 0.0))
            return of(after), sound & ~(last > end - minute / 2.0)

        def pct(count: Floats) -> Any:
            return of(100.0 * count / points)

        settling_2pct, settled_2pct = settled(t.outside_2pct_t_min)
        settling_5pct, settled_5pct = settled(t.outside_5pct_t_min)
        mean = of(setpoint + t.deviation / points)
        variance = (of(t.squared_deviation) - of(t.deviation) ** 2 / points) / (points - 1)
        slack = _ROUNDING_MU_MIN[precision]
        rate = delivered & (t.largest_change <= self.limits.max_change_mU_min + slack)
        magnitude = (
            delivered
            & (t.lowest_mU_min >= self.limits.min_mU_min - slack)
            & (t.highest_mU_min <= self.limits.max_mU_min + slack)
        )
        above = sound & (t.minimum_mg_dl >= self.lowest_glucose_mg_dl)
        very_low, very_high = pct(t.below_54), pct(t.above_250)
        low, high = pct(t.below_70) - very_low, pct(t.above_180) - very_high
        return Metrics(
            undershoot_mg_dl=of(setpoint - t.minimum_mg_dl),
            minimum_mg_dl=of(t.minimum_mg_dl),
            minimum_t_min=of(t.minimum_t_min),
            overshoot_mg_dl=of(t.peak_mg_dl - setpoint),
            peak_mg_dl=of(t.peak_mg_dl),
            peak_t_min=of(t.peak_t_min),
            settling_2pct_min=settling_2pct,
            settled_2pct=settled_2pct,
            settling_5pct_min=settling_5pct,
            settled_5pct=settled_5pct,
            sse=of(t.sse, np.isfinite(t.sse)),
            time_below_54_pct=very_low,
            time_below_60_pct=pct(t.below_60),
            time_below_70_pct=pct(t.below_70),
            time_below_validity_pct=pct(t.below_validity),
            low_events=of(t.low.events),
            very_low_events=of(t.very_low.events),
            time_70_180_pct=pct(points - t.below_70 - t.above_180),
            time_above_180_pct=pct(t.above_180),
            time_above_250_pct=very_high,
            mean_mg_dl=mean,
            cv_pct=100.0 * np.sqrt(np.maximum(variance, 0.0)) / mean,
            gmi_pct=of(np.asarray(glycemic.glucose_management_indicator_pct(mean))),
            lbgi=of(t.low_risk / points),
            hbgi=of(t.high_risk / points),
            gri=of(np.asarray(glycemic.risk_index_of_pct(very_low, low, high, very_high))),
            insulin_total_mU=of(t.insulin * sample_time_min, delivered),
            insulin_total_variation_mU_min=of(t.variation, delivered),
            largest_change_mU_min=of(t.largest_change, delivered),
            rate_satisfied=rate,
            magnitude_satisfied=magnitude,
            glucose_satisfied=above,
            constraints_satisfied=rate & magnitude & above,
            samples_saturated=t.saturated.astype(np.int64),
            samples_missing=t.missing.astype(np.int64),
            samples_not_converged=t.not_converged.astype(np.int64),
            samples_non_finite=t.non_finite.astype(np.int64),
            samples_rejected=t.rejected.astype(np.int64),
            samples_fallback=t.fallback.astype(np.int64),
            samples_suspended=t.suspended.astype(np.int64),
            samples_dose_limited=t.dose_limited.astype(np.int64),
        )


_SUMS: Final = (
    *(
        "sse",
        "below_54",
        "below_60",
        "below_70",
        "below_validity",
        "above_180",
        "above_250",
        "deviation",
        "squared_deviation",
    ),
    *("low_risk", "high_risk", "insulin", "variation", "largest_change"),
    *("saturated", "missing", "not_converged", "non_finite", "rejected", "fallback", "suspended", "dose_limited"),
)
"""Fields of a tally that begin at zero."""
