"""Tables, figures and pages of results. Plotting libraries are imported only when something is drawn."""

from glucoloop.report.columns import comparison_table, metrics_table
from glucoloop.report.figure import plot
from glucoloop.report.identification_figure import plot_identification, plot_validation
from glucoloop.report.page import interactive_page
from glucoloop.report.template import Repeat
from glucoloop.report.trial_figure import plot_trial
from glucoloop.report.trial_page import trial_page
from glucoloop.report.trial_report import CaseReport, MetricDistribution, TrialReport, WorstPerson

__all__ = [
    "CaseReport",
    "MetricDistribution",
    "Repeat",
    "TrialReport",
    "WorstPerson",
    "comparison_table",
    "interactive_page",
    "metrics_table",
    "plot",
    "plot_identification",
    "plot_trial",
    "plot_validation",
    "trial_page",
]
