"""Results of a test of estimators: meals, thresholds, the error of the size over time, and an example day."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

TOLD_AFTER_MIN: Final = (30.0, 60.0, 90.0, 120.0)
"""Times after a meal's beginning at which its expected size is judged."""
QUANTILES: Final = (0.1, 0.5, 0.9)
SIZES_G: Final = (0.0, 30.0, 60.0, np.inf)
"""Limits between small, middling and large meals."""


@dataclass(frozen=True)
class MealTable:
    """Meals, one row ``(n,)`` per meal."""

    person: npt.NDArray[np.int64]
    day: npt.NDArray[np.int64]
    t_min: Array
    """Beginning of the meal, from the start of the day."""
    carbs_g: Array
    delay_min: Array
    """Delay of the detection; NaN for a meal that was missed, or that began with the probability above the threshold
    already.
    """
    already: npt.NDArray[np.bool_]
    """Whether the probability was above the threshold when the meal began."""
    estimated_g: Array
    """Estimated size 60 min after the end of the meal; NaN if it was not detected, another one had begun or the day was
    over.
    """
    expected_g: Mapping[float, Array]
    """Expected final size at times in minutes after the beginning. NaN in the same cases, and before the detection,
    since until then the estimate is about the meal before.
    """

    @property
    def missed(self) -> npt.NDArray[np.bool_]:
        """Whether the meal was neither detected nor began with the probability above the threshold."""
        return ~np.isfinite(self.delay_min) & ~self.already

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Columns of a table, by name, for files."""
        own = {
            name: getattr(self, name)
            for name in ("person", "day", "t_min", "carbs_g", "delay_min", "already", "missed", "estimated_g")
        }
        return own | {f"expected_{after:.0f}_min_g": values for after, values in self.expected_g.items()}


@dataclass(frozen=True)
class Curve:
    """Performance as a function of the threshold ``(n,)``."""

    threshold: Array
    delay_median_min: Array
    """Median delay of the detected meals; NaN if none is detected."""
    delay_p90_min: Array
    missed_pct: Array
    already_pct: Array
    false_alarms_fasting_per_day: Array
    """False alarms on days without a meal."""
    false_alarms_between_per_day: Array
    """False alarms between meals, per day of that time; NaN without any such time."""

    def columns(self) -> dict[str, Array]:
        """Columns of a table, by name, for files."""
        return dict(vars(self))


@dataclass(frozen=True)
class SizeError:
    """Expected size less the true one, by the time since the meal's beginning; quantiles over meals."""

    after_min: Array
    """(n,) times since the meal's beginning."""
    error_g: Array
    """(3, n) quantiles 0.1, 0.5 and 0.9 of the error."""
    meals: npt.NDArray[np.int64]
    """(n,) number of meals that count: detected by then, and not over."""

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Columns of a table, by name, for files."""
        of = {f"error_p{100 * q:.0f}_g": row for q, row in zip(QUANTILES, self.error_g, strict=True)}
        return {"after_min": self.after_min, **of, "meals": self.meals}


@dataclass(frozen=True)
class ExampleDay:
    """The first day of the first person."""

    t_min: Array
    """(samples,) times of the samples."""
    glucose_mg_dl: Array
    """(samples,) glucose free of noise."""
    reading_mg_dl: Array
    insulin_mU_min: Array
    eating: Array
    emptying_mg_min: Array
    """(samples,) true rate at which the stomach empties."""
    estimated_emptying_mg_min: Array
    carbs_g: Array
    """(samples,) estimated size of the latest meal."""
    remaining_g: Array

    def columns(self) -> dict[str, Array]:
        """Columns of a table, by name, for files."""
        return dict(vars(self))


@dataclass(frozen=True)
class EstimatorResult:
    """Results of one estimator."""

    estimator: str
    controller: str
    threshold: float
    meals: MealTable
    curve: Curve
    """Performance at several thresholds."""
    size_error: SizeError
    fasting_days: float
    between_days: float
    """Time between meals on days with meals, in days."""
    example: ExampleDay

    def summary(self) -> dict[str, Any]:
        """Numbers of a table row; None for a number without meals."""
        meals, at = self.meals, int(np.flatnonzero(self.curve.threshold == self.threshold)[0])
        return {
            **_of_meals(meals, np.ones(meals.carbs_g.size, bool)),
            "false_alarms_fasting_per_day": _number(self.curve.false_alarms_fasting_per_day[at]),
            "fasting_days": self.fasting_days,
            "false_alarms_between_per_day": _number(self.curve.false_alarms_between_per_day[at]),
            "between_days": self.between_days,
            "by_size": [
                {
                    "from_g": low,
                    "to_g": None if np.isinf(high) else high,
                    **_of_meals(meals, (meals.carbs_g >= low) & (meals.carbs_g < high)),
                }
                for low, high in itertools.pairwise(SIZES_G)
            ],
        }


@dataclass(frozen=True)
class DetectionResult:
    """Results of all estimators."""

    estimators: tuple[EstimatorResult, ...]
    days: int
    """Number of days with meals; there are as many without a meal."""
    infeasible: int
    """People without a basal rate that holds them at the setpoint, who are left out."""


def _of_meals(meals: MealTable, which: npt.NDArray[np.bool_]) -> dict[str, Any]:
    delay, number = meals.delay_min[which], int(which.sum())
    p10, p50, p90 = quantiles(delay)
    told: dict[str, Any] = {
        "meals": number,
        "detected_pct": share_pct(np.isfinite(delay)),
        "missed_pct": share_pct(meals.missed[which]),
        "already_pct": share_pct(meals.already[which]),
        "delay_p10_min": p10,
        "delay_median_min": p50,
        "delay_p90_min": p90,
        "delay_max_min": _number(np.nanmax(delay)) if np.isfinite(delay).any() else None,
    }
    sizes = {"after_end": meals.estimated_g} | {f"at_{t:.0f}_min": of for t, of in meals.expected_g.items()}
    for name, of in sizes.items():
        error = of[which] - meals.carbs_g[which]
        low, middle, high = quantiles(error)
        told |= {
            f"size_error_{name}_p10_g": low,
            f"size_error_{name}_median_g": middle,
            f"size_error_{name}_p90_g": high,
            f"size_error_{name}_mean_absolute_g": _number(np.nanmean(np.abs(error)))
            if np.isfinite(error).any()
            else None,
            f"size_error_{name}_meals": int(np.isfinite(error).sum()),
        }
    return told


def quantiles(values: Array) -> tuple[float | None, float | None, float | None]:
    """Quantiles 10 %, 50 % and 90 % of the finite values; None without any."""
    known = values[np.isfinite(values)]
    if not known.size:
        return None, None, None
    low, middle, high = np.quantile(known, QUANTILES).tolist()
    return low, middle, high


def share_pct(which: npt.NDArray[np.bool_]) -> float | None:
    """Percentage of true values; None without values."""
    return float(100.0 * which.mean()) if which.size else None


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
