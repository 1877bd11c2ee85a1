"""Rows of a table of metrics: name, unit and format of each metric."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from glucoloop.metrics import Metrics
from glucoloop.units import MG_DL_PER_MMOL_L, MU_PER_U

NOT_AVAILABLE: Final = "n/a"


@dataclass(frozen=True)
class Row:
    """One metric of one run or of several."""

    section: str
    name: str
    unit: str
    values: tuple[str, ...]
    mmol_l: tuple[str, ...] | None = None
    """The values in mmol/l, of a metric in mg/dl."""


@dataclass(frozen=True)
class Described:
    """Description of a metric: its value divided by the divisor is in the unit."""

    name: str
    unit: str
    digits: int
    divisor: float

    @property
    def title(self) -> str:
        """Name and unit of the metric."""
        return f"{self.name} ({self.unit})" if self.unit else self.name

    def value(self, value: float) -> str:
        """Text of a value of the metric, without its unit."""
        return f"{value / self.divisor:z.{self.digits}f}" if math.isfinite(value) else NOT_AVAILABLE


@dataclass(frozen=True)
class _Entry:
    field: str
    name: str
    unit: str = ""
    digits: int = 1
    divisor: float = 1.0
    settled: str = ""
    """Field that says whether the value is more than a lower bound."""
    seldom: bool = False
    """Whether the metric is left out if it is 0 in all runs."""

    def row(self, section: str, metrics: Sequence[Mapping[str, float | int | bool | None]]) -> Row:
        values = tuple(map(self.value, metrics))
        if self.unit != "mg/dl":
            return Row(section, self.name, self.unit, values)
        other = dataclasses.replace(self, digits=2, divisor=MG_DL_PER_MMOL_L)
        return Row(section, self.name, self.unit, values, tuple(map(other.value, metrics)))

    def value(self, metrics: Mapping[str, float | int | bool | None]) -> str:
        value = metrics[self.field]
        if value is None:
            return NOT_AVAILABLE
        if isinstance(value, bool):
            return "yes" if value else "no"
        more = "+" if self.settled and not metrics[self.settled] else ""
        return f"{value / self.divisor:z.{self.digits}f}{more}"


_SECTIONS: Final[dict[str, tuple[_Entry, ...]]] = {
    "Regulation": (
        _Entry("undershoot_mg_dl", "Undershoot", "mg/dl"),
        _Entry("overshoot_mg_dl", "Overshoot", "mg/dl"),
        _Entry("settling_2pct_min", "Settling, 2 % band", "min", 0, settled="settled_2pct"),
        _Entry("settling_5pct_min", "Settling, 5 % band", "min", 0, settled="settled_5pct"),
        _Entry("minimum_mg_dl", "Least glucose", "mg/dl"),
        _Entry("minimum_t_min", "  at", "min", 0),
        _Entry("peak_mg_dl", "Greatest glucose", "mg/dl"),
        _Entry("peak_t_min", "  at", "min", 0),
        _Entry("sse", "Sum of squared errors", "(mg/dl)²", 0),
    ),
    "Glycemia": (
        _Entry("time_below_54_pct", "Time below 54 mg/dl", "%"),
        _Entry("time_below_60_pct", "Time below 60 mg/dl", "%"),
        _Entry("time_below_70_pct", "Time below 70 mg/dl", "%"),
        _Entry("time_below_validity_pct", "Time below the model's validity", "%", seldom=True),
        _Entry("low_events", "Events below 70 mg/dl", "", 0),
        _Entry("very_low_events", "Events below 54 mg/dl", "", 0),
        _Entry("time_70_180_pct", "Time from 70 to 180 mg/dl", "%"),
        _Entry("time_above_180_pct", "Time above 180 mg/dl", "%"),
        _Entry("time_above_250_pct", "Time above 250 mg/dl", "%"),
        _Entry("mean_mg_dl", "Mean glucose", "mg/dl"),
        _Entry("cv_pct", "Coefficient of variation", "%"),
        _Entry("gmi_pct", "Glucose management indicator", "%"),
        _Entry("lbgi", "Low blood glucose index", "", 2),
        _Entry("hbgi", "High blood glucose index", "", 2),
        _Entry("gri", "Glycemia risk index"),
    ),
    "Insulin": (
        _Entry("insulin_total_mU", "Insulin delivered", "U", 2, divisor=MU_PER_U),
        _Entry("insulin_total_variation_mU_min", "Total variation", "mU/min"),
        _Entry("largest_change_mU_min", "Largest change", "mU/min"),
    ),
    "Constraints kept": (
        _Entry("rate_satisfied", "Rate of change"),
        _Entry("magnitude_satisfied", "Magnitude"),
        _Entry("glucose_satisfied", "Least glucose"),
        _Entry("constraints_satisfied", "All"),
    ),
    "Samples": (
        _Entry("samples_saturated", "Dose beyond limits", "", 0),
        _Entry("samples_missing", "Reading missing", "", 0),
        _Entry("samples_not_converged", "Not converged", "", 0),
        _Entry("samples_non_finite", "Dose not finite", "", 0),
        _Entry("samples_rejected", "Reading not believed", "", 0, seldom=True),
        _Entry("samples_fallback", "Fallback to the basal rate", "", 0, seldom=True),
        _Entry("samples_suspended", "Insulin suspended", "", 0, seldom=True),
        _Entry("samples_dose_limited", "Dose cut by the guard", "", 0, seldom=True),
    ),
}


def metric_rows(metrics: Mapping[str, Metrics]) -> list[Row]:
    """Rows for runs by label, one value per run; a time that is only a lower bound ends in "+".

    Raises
    ------
    ValueError
        If there are no metrics, or some are of many people.
    """
    if not metrics:
        raise ValueError("there are no metrics to show; give those of at least one run")
    plain = [of_run.as_dict() for of_run in metrics.values()]
    return [
        entry.row(section, plain)
        for section, entries in _SECTIONS.items()
        for entry in entries
        if not entry.seldom or any(values[entry.field] for values in plain)
    ]


def described(field: str) -> Described:
    """Description of a metric.

    Raises
    ------
    ValueError
        For a name that is not that of a metric.
    """
    known = {entry.field: entry for entries in _SECTIONS.values() for entry in entries}
    if field not in known:
        raise ValueError(f"unknown metric {field!r}; use one of {', '.join(known)}")
    entry = known[field]
    return Described(entry.name, entry.unit, entry.digits, entry.divisor)
