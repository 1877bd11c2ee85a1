"""Metrics of a run: regulation, glycemic risk and constraints, as pure functions of a trace."""

from glucoloop.metrics.constraints import (
    LOWEST_GLUCOSE_MG_DL,
    glucose_satisfied,
    insulin_changes,
    magnitude_satisfied,
    rate_satisfied,
)
from glucoloop.metrics.glycemic import (
    RiskIndices,
    coefficient_of_variation_pct,
    glucose_management_indicator_pct,
    glycemia_risk_index,
    risk_indices,
    time_above_pct,
    time_below_pct,
    time_between_pct,
)
from glucoloop.metrics.regulation import Extreme, Settling, minimum, peak, settling, sum_squared_error
from glucoloop.metrics.summary import Metrics, summarise

__all__ = [
    "LOWEST_GLUCOSE_MG_DL",
    "Extreme",
    "Metrics",
    "RiskIndices",
    "Settling",
    "coefficient_of_variation_pct",
    "glucose_management_indicator_pct",
    "glucose_satisfied",
    "glycemia_risk_index",
    "insulin_changes",
    "magnitude_satisfied",
    "minimum",
    "peak",
    "rate_satisfied",
    "risk_indices",
    "settling",
    "sum_squared_error",
    "summarise",
    "time_above_pct",
    "time_below_pct",
    "time_between_pct",
]
