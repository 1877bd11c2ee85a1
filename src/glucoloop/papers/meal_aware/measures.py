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
class RunMeasure:
    """One number that describes a run."""

    name: str
    title: str
    unit: str
    digits: int = 1


MEASURES: Final = (
    RunMeasure("undershoot_mg_dl", "Undershoot", "mg/dl"),
    RunMeasure("overshoot_mg_dl", "Peak above setpoint", "mg/dl"),
    RunMeasure("deviation_mg_dl", "Largest deviation", "mg/dl"),
    RunMeasure("late_deviation_mg_dl", f"Largest deviation, last {LATE_MIN:g} min", "mg/dl"),
    RunMeasure("late_swings", f"Swings, last {LATE_MIN:g} min", "", 0),
    RunMeasure("minimum_mg_dl", "Lowest glucose", "mg/dl"),
    RunMeasure("time_near_pct", f"Time within {NEAR_MG_DL:g} mg/dl", "%"),
    RunMeasure("time_below_60_pct", "Time below 60 mg/dl", "%", 2),
    RunMeasure("settling_5pct_min", "Settling, 5 %", "min", 0),
    RunMeasure("insulin_total_variation_mU_min", "Total variation of insulin", "mU/min", 0),
)
"""Measures of noise-free glucose on a grid of one minute."""


AT_SAMPLES: Final = (
    RunMeasure("undershoot_mg_dl", "Undershoot", "mg/dl"),
    RunMeasure("overshoot_mg_dl", "Peak above setpoint", "mg/dl"),
    RunMeasure("deviation_mg_dl", "Largest deviation", "mg/dl"),
    RunMeasure("minimum_mg_dl", "Lowest glucose", "mg/dl"),
    RunMeasure("time_below_60_pct", "Time below 60 mg/dl", "%", 2),
    RunMeasure("late_offset_mg_dl", f"Mean less setpoint, last {LATE_MIN:g} min", "mg/dl", 2),
    RunMeasure("late_swing_mg_dl", f"Highest less lowest, last {LATE_MIN:g} min", "mg/dl", 2),
    RunMeasure("late_variation_mU_min", f"Total variation of insulin, last {LATE_MIN:g} min", "mU/min", 0),
)
"""Measures of noise-free glucose at the samples."""


def numbers_of(
    metrics: Mapping[str, Floats], t_min: Floats, glucose_mg_dl: Floats, setpoint: float
) -> dict[str, Floats]:
    """Compute the measures of runs.

    Parameters
    ----------
    metrics : mapping
        (runs,) each, by the name of a result of `parts.metrics`.
    t_min : (points,) array
    glucose_mg_dl : (points, runs) array
        Glucose; it is interpolated linearly where the points are farther apart than a minute.
    setpoint : float
    """
    minutes = np.arange(t_min[0], t_min[-1] + 0.5)
    away, late = np.abs(glucose_mg_dl - setpoint), t_min >= t_min[-1] - LATE_MIN
    by_minute = np.stack([np.interp(minutes, t_min, of_run) for of_run in glucose_mg_dl.T], axis=1)
    near = np.abs(by_minute - setpoint) <= NEAR_MG_DL
    swings = jax.vmap(lambda of_run: crossings(of_run, setpoint, SWING_MG_DL / setpoint), in_axes=1)(
        glucose_mg_dl[late]
    )
    own = {
        "deviation_mg_dl": np.maximum(metrics["undershoot_mg_dl"], metrics["overshoot_mg_dl"]),
        "late_deviation_mg_dl": away[late].max(axis=0),
        "late_swings": swings,
        "time_near_pct": np.where(np.isfinite(away).all(axis=0), 100.0 * near.mean(axis=0), np.nan),
    }
    return {measure.name: np.asarray({**metrics, **own}[measure.name], float) for measure in MEASURES}


def numbers_at_samples(
    glucose_mg_dl: Floats, insulin_mU_min: Floats, setpoint_mg_dl: float, sample_time_min: float
) -> dict[str, Floats]:
    """Compute the measures `AT_SAMPLES` of runs.

    Parameters
    ----------
    glucose_mg_dl : (samples + 1, runs) array
    insulin_mU_min : (samples, runs) array
        Rates delivered from each sample to the next.
    setpoint_mg_dl, sample_time_min : float
    """
    away, points = glucose_mg_dl - setpoint_mg_dl, round(LATE_MIN / sample_time_min) + 1
    late = away[-points:]
    found = {
        "undershoot_mg_dl": np.maximum(-away.min(axis=0), 0.0),
        "overshoot_mg_dl": away.max(axis=0),
        "deviation_mg_dl": np.abs(away).max(axis=0),
        "minimum_mg_dl": glucose_mg_dl.min(axis=0),
        "time_below_60_pct": 100.0 * (glucose_mg_dl < 60.0).mean(axis=0),
        "late_offset_mg_dl": late.mean(axis=0),
        "late_swing_mg_dl": late.max(axis=0) - late.min(axis=0),
        "late_variation_mU_min": np.abs(np.diff(insulin_mU_min[-points:], axis=0)).sum(axis=0),
    }
    return {measure.name: found[measure.name] for measure in AT_SAMPLES}
