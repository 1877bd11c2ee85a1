"""Tuning searches: every tuning of a grid in the loop, and which of them are any good."""

from glucoloop.registry.controllers import TUNABLE
from glucoloop.trials.tuning.designers import Designer, designer, uses_reference_filter
from glucoloop.trials.tuning.grid import parse_integers, parse_numbers, tuning_grid
from glucoloop.trials.tuning.oscillation import Oscillation, oscillation
from glucoloop.trials.tuning.paper import (
    REFERENCE_FILTERS,
    paper_tuning_rank,
    paper_tuning_surface,
    printed_tuning,
    usual_tuning,
)
from glucoloop.trials.tuning.search import search
from glucoloop.trials.tuning.surface import TuningRank, TuningSurface, tuning_text

__all__ = [
    "REFERENCE_FILTERS",
    "TUNABLE",
    "Designer",
    "Oscillation",
    "TuningRank",
    "TuningSurface",
    "designer",
    "oscillation",
    "paper_tuning_rank",
    "paper_tuning_surface",
    "parse_integers",
    "parse_numbers",
    "printed_tuning",
    "search",
    "tuning_grid",
    "tuning_text",
    "uses_reference_filter",
    "usual_tuning",
]
