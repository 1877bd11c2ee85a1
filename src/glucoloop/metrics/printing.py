"""Short table of metrics for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

_ROWS: Final = (
    ("minimum_mg_dl", "least glucose", "mg/dl", 1),
    ("peak_mg_dl", "greatest glucose", "mg/dl", 1),
    ("mean_mg_dl", "mean glucose", "mg/dl", 1),
    ("undershoot_mg_dl", "undershoot below the setpoint", "mg/dl", 1),
    ("settling_2pct_min", "settled to 2 % after", "min", 0),
    ("time_70_180_pct", "time from 70 to 180 mg/dl", "%", 1),
    ("time_below_70_pct", "time below 70 mg/dl", "%", 1),
    ("time_below_54_pct", "time below 54 mg/dl", "%", 1),
    ("time_above_180_pct", "time above 180 mg/dl", "%", 1),
    ("cv_pct", "coefficient of variation", "%", 1),
    ("gri", "glycemia risk index", "", 1),
    ("insulin_total_mU", "insulin", "mU", 0),
)


def short_table(metrics: Mapping[str, Any]) -> str:
    """The most used metrics with units: of one person, or their distribution over people.

    Parameters
    ----------
    metrics : mapping of str to array
        Metrics by the names of the fields of `Metrics`.
    """
    people = np.shape(metrics["minimum_mg_dl"])
    lines = [f"{'':31}{'5 %':>9}{'median':>9}{'95 %':>9}   of {np.prod(people, dtype=int)} people"] if people else []
    for field, name, unit, digits in _ROWS:
        values = np.asarray(metrics[field], float)
        finite = values[np.isfinite(values)]
        told = np.percentile(finite, [5, 50, 95]) if people and finite.size else values.reshape(-1)[:1]
        bound = "" if people or field != "settling_2pct_min" or bool(metrics["settled_2pct"]) else "not "
        lines.append(f"{bound + name:31}" + "".join(f"{value:9.{digits}f}" for value in told) + f" {unit}".rstrip())
    return "\n".join(lines)
