"""Measures of runs: numbers that describe glucose free of noise and delivered insulin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.tuning.oscillation import crossings

Floats = npt.NDArray[np.float64]

NEAR_MG_DL: Final = 15.0
"""Distance from the setpoint within which glucose counts as near it."""
LATE_MIN: Final = 200.0
"""Length of the last part of a run, for measures of its end."""
SWING_MG_DL: Final = 5.0
"""Smallest deviation to either side of the setpoint that counts as a swing. It is the largest error of a reading, so
that noise alone makes no swing.
"""


@dataclass(frozen=True)
class Runs:
    """Runs of one controller in one situation."""

    run: npt.NDArray[np.int64]
    """(runs,) seeds of the sensor, or numbers of the runs or people."""
    numbers: Mapping[str, Floats]
    """(runs,) values of each measure, by its name; those of the run without noise, by names with ``quiet``, (1,)."""
    infeasible: int = 0
    """Number of people without a basal rate for the setpoint, who are not among the runs."""


def numbers_by_minute(
    metrics: Mapping[str, Floats], t_min: Floats, glucose_mg_dl: Floats, setpoint_mg_dl: float
) -> dict[str, Floats]:
    """Compute the measures of runs whose glucose is known on a fine grid.

    Parameters
    ----------
    metrics : mapping
        (runs,) each, by the name of a result of `metrics.metric`.
    t_min : (points,) array
    glucose_mg_dl : (points, runs) array
        Glucose; it is interpolated linearly where the points are farther apart than a minute.
    setpoint_mg_dl : float
    """
    minutes = np.arange(t_min[0], t_min[-1] + 0.5)
    away, late = np.abs(glucose_mg_dl - setpoint_mg_dl), t_min >= t_min[-1] - LATE_MIN
    by_minute = np.stack([np.interp(minutes, t_min, of_run) for of_run in glucose_mg_dl.T], axis=1)
    near = np.abs(by_minute - setpoint_mg_dl) <= NEAR_MG_DL
    swings = jax.vmap(lambda of_run: crossings(of_run, setpoint_mg_dl, SWING_MG_DL / setpoint_mg_dl), in_axes=1)(
        glucose_mg_dl[late]
    )
    unchanged = ("undershoot_mg_dl", "overshoot_mg_dl", "minimum_mg_dl", "insulin_total_variation_mU_min")
    return {
        **{name: np.asarray(metrics[name], float) for name in unchanged},
        "deviation_mg_dl": np.maximum(metrics["undershoot_mg_dl"], metrics["overshoot_mg_dl"]),
        "late_swings": np.asarray(swings, float),
        "time_near_pct": np.where(np.isfinite(away).all(axis=0), 100.0 * near.mean(axis=0), np.nan),
    }


def numbers_at_samples(
    glucose_mg_dl: Floats, insulin_mU_min: Floats, setpoint_mg_dl: float, sample_time_min: float
) -> dict[str, Floats]:
    """Compute the measures of runs whose glucose is known at the samples.

    Parameters
    ----------
    glucose_mg_dl : (samples + 1, runs) array
    insulin_mU_min : (samples, runs) array
        Rates delivered from each sample to the next.
    setpoint_mg_dl, sample_time_min : float
    """
    away, points = glucose_mg_dl - setpoint_mg_dl, round(LATE_MIN / sample_time_min) + 1
    late = away[-points:]
    return {
        "undershoot_mg_dl": np.maximum(-away.min(axis=0), 0.0),
        "overshoot_mg_dl": away.max(axis=0),
        "deviation_mg_dl": np.abs(away).max(axis=0),
        "minimum_mg_dl": glucose_mg_dl.min(axis=0),
        "time_below_60_pct": 100.0 * (glucose_mg_dl < 60.0).mean(axis=0),
        "late_offset_mg_dl": late.mean(axis=0),
        "late_swing_mg_dl": late.max(axis=0) - late.min(axis=0),
        "late_variation_mU_min": np.abs(np.diff(insulin_mU_min[-points:], axis=0)).sum(axis=0),
    }
