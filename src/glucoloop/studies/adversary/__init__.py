"""The worst plausible sensor errors: what a search finds that makes a controller do the most harm."""

from glucoloop.studies.adversary.attack import Attack, Harm, Lane
from glucoloop.studies.adversary.outcome import Cell, Outcome, search_all
from glucoloop.studies.adversary.random_errors import RandomErrors, random_errors
from glucoloop.studies.adversary.search import (
    Effort,
    Generation,
    Judge,
    Worst,
    generations,
    judge_of,
    worst_errors,
    worst_of,
)
from glucoloop.studies.adversary.space import ErrorSpace

__all__ = [
    "Attack",
    "Cell",
    "Effort",
    "ErrorSpace",
    "Generation",
    "Harm",
    "Judge",
    "Lane",
    "Outcome",
    "RandomErrors",
    "Worst",
    "generations",
    "judge_of",
    "random_errors",
    "search_all",
    "worst_errors",
    "worst_of",
]
