"""Outcomes of the searches: every controller, guarded or not, under errors of every size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from glucoloop.cohorts.trial import Trial
from glucoloop.control import Controller
from glucoloop.experiments.designs import controller_of
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.situations.case import Case
from glucoloop.studies.adversary.attack import Attack
from glucoloop.studies.adversary.random_errors import RandomErrors, random_errors
from glucoloop.studies.adversary.search import Effort, Generation, Worst, generations, judge_of, worst_of
from glucoloop.studies.adversary.space import ErrorSpace

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class ErrorSearch:
    """One search: a controller, guarded or not, the largest error, and the effort."""

    case: Case
    space: ErrorSpace
    effort: Effort

    @property
    def guarded(self) -> bool:
        """Whether there is a guard around the controller."""
        return self.case.guard is not None

    @property
    def controller(self) -> str:
        """The controller in words."""
        return f"{self.case.label}, guarded" if self.guarded else self.case.label

    @property
    def error_pct(self) -> float:
        """Largest error of a reading."""
        return 100.0 * self.space.error

    @property
    def name(self) -> str:
        """Label of the search, unique among all searches."""
        return f"{self.controller}, ±{self.error_pct:g} %"


@dataclass(frozen=True)
class SearchOutcome:
    """Outcome of one search."""

    cell: ErrorSearch
    engine: str
    """Engine that simulated the loops, native or xla."""
    peak_without_errors_mg_dl: float
    lowest_without_errors_mg_dl: float
    worst: Worst
    random: RandomErrors
    """Result of random errors of the same size, on the people of the trial."""


def search_all(
    groups: Iterable[tuple[Trial, Sequence[ErrorSearch]]],
    person: int | None,
    *,
    before: Mapping[str, Sequence[Array]] | None = None,
    told: Callable[[ErrorSearch, Generation], None] | None = None,
) -> Iterator[SearchOutcome]:
    """Yield the outcome of each search as soon as it is known.

    Parameters
    ----------
    groups : iterable of (Trial, cells)
        Trials of one case, and its searches, which differ only in the size of the errors. The search for larger
        errors begins at the worst of the smaller ones.
    person : int or None
        Subject of the search: a person of the population, or None for the nominal patient.
    before : mapping, optional
        Scores of generations that are known, by the name of the cell, see `generations`.
    told : callable, optional
        Called after each generation.

    Raises
    ------
    ValueError
        For a design that is not possible, or a person without a basal rate.
    """
    for trial, cells in groups:
        with one_at_a_time:
            attack = Attack(trial, _designed(trial), cells[0].space, lanes=cells[0].effort.lanes)
            who = attack.one(person)
        smaller: tuple[ErrorSpace, Array] | None = None
        for cell in sorted(cells, key=lambda cell: cell.error_pct):
            kept = (before or {}).get(cell.name, ())
            known = None if smaller is None else cell.space.points_of(*smaller)
            for generation in generations(judge_of(attack, who), cell.space, cell.effort, kept, known):
                if told is not None:
                    told(cell, generation)
            smaller = cell.space, generation.best
            never = np.full((cell.space.stretches, 1), float(cell.space.samples))
            without = attack.on_one(who, np.zeros((cell.space.samples, 1)), never)
            yield SearchOutcome(
                cell=cell,
                engine=attack.engine,
                peak_without_errors_mg_dl=float(without.peak_mg_dl[0]),
                lowest_without_errors_mg_dl=float(without.lowest_mg_dl[0]),
                worst=worst_of(attack, who, cell.space, generation),
                random=random_errors(attack, cell.space, trial.people, cell.effort.seed),
            )


def _designed(trial: Trial) -> Controller:
    return controller_of(trial, trial.cases[0])
