"""Metrics of a run, each a fold: regulation, glycemic risk, insulin, constraints and what the samples met."""

from glucoloop.metrics.clinical import ClinicalSummary, clinical_summary
from glucoloop.metrics.metrics import Metrics
from glucoloop.metrics.protocol import LOWEST_GLUCOSE_MG_DL, Course, Ended, Metric
from glucoloop.metrics.running import RunningMetrics, summarise

__all__ = [
    "LOWEST_GLUCOSE_MG_DL",
    "ClinicalSummary",
    "Course",
    "Ended",
    "Metric",
    "Metrics",
    "RunningMetrics",
    "clinical_summary",
    "summarise",
]
