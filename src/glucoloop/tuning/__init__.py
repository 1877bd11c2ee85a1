"""Tuning searches: every tuning of a grid in the loop, and which of them are any good."""

from glucoloop.registry.controllers import TUNABLE
from glucoloop.tuning.designers import Designer, designer, uses_reference_filter
from glucoloop.tuning.grid import parse_integers, parse_numbers, tuning_grid
from glucoloop.tuning.oscillation import Oscillation, oscillation
from glucoloop.tuning.paper import (
    REFERENCE_FILTERS,
    paper_tuning_rank,
    paper_tuning_surface,
    printed_tuning,
    usual_tuning,
)
from glucoloop.tuning.search import search
from glucoloop.tuning.surface import TuningRank, TuningSurface, tuning_text

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
