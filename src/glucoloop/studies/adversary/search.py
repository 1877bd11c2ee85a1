"""The search for the worst errors of one person: generation after generation, from the harm of the one before."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from glucoloop.patients.population import VirtualPeople
from glucoloop.refusal import Refusal
from glucoloop.studies.adversary.attack import Attack, Lane
from glucoloop.studies.adversary.space import ErrorSpace
from glucoloop.tuning.evolution import Evolution

Array = npt.NDArray[Any]
Judge = Callable[[Array, Array], Array]
"""Harm ``(n,)`` of sequences of errors ``(samples, n)`` with stuck stretches from the samples ``(stretches, n)`` on."""


@dataclass(frozen=True)
class Effort:
    """Effort of a search.

    Raises
    ------
    ValueError
        For a number out of its bounds.
    """

    generations: int = 300
    starts: int = 8
    """Number of searches side by side."""
    population: int = 32
    """Number of sequences in a generation of each start."""
    seed: int = 1

    def __post_init__(self) -> None:
        for name, least, most in (
            ("generations", 1, 1_000_000),
            ("starts", 1, 1024),
            ("population", 4, 4096),
            ("seed", 0, 2**32 - 1),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
                raise Refusal(f"{name} is {value!r}; give a whole number from {least} to {most}")

    @property
    def lanes(self) -> int:
        """Number of loops in a generation."""
        return self.starts * self.population


@dataclass(frozen=True)
class Generation:
    """Results of one generation of all starts."""

    number: int
    score: Array
    """(lanes,) harm of each sequence."""
    best_score: float
    """Largest score of all generations so far."""
    best: Array
    """(dimension,) sequence with that score."""


@dataclass(frozen=True)
class Worst:
    """The worst errors that were found, and their effect."""

    errors: Array
    """(samples,) errors relative to the true glucose."""
    stuck_from: Array
    """(stretches,) number of the sample at which each stretch begins, in order."""
    below_54_min: float
    lowest_mg_dl: float
    peak_mg_dl: float
    tried: int
    """Number of sequences that were tried."""
    lane: Lane


def generations(
    judge: Judge, space: ErrorSpace, effort: Effort, before: Sequence[Array] = (), known: Array | None = None
) -> Iterator[Generation]:
    """Yield the generations of a search, each as soon as it is known.

    Parameters
    ----------
    judge : callable
    space : ErrorSpace
    effort : Effort
    before : sequence of (lanes,) array
        Scores of the generations that were found before, in order; they are not simulated again.
    known : (dimension,) array, optional
        A sequence that is tried first, and from which one of the starts continues: the worst of smaller errors, so that
        the harm found for larger ones is never less.

    Raises
    ------
    ValueError
        If the search library is not installed.
    """
    sampler = Evolution(space.centre, starts=effort.starts, population=effort.population, seed=effort.seed, known=known)
    best_score, best = -np.inf, np.zeros(space.dimension)
    for number in range(effort.generations):
        points = sampler.ask()
        if number < len(before):
            score = np.asarray(before[number], float)
        else:
            score = judge(space.errors(points), space.stuck_from(points))
        most = int(np.argmax(score))
        if score[most] > best_score:
            best_score, best = float(score[most]), points[most]
        sampler.tell(score)
        yield Generation(number=number, score=score, best_score=best_score, best=best)


def worst_errors(attack: Attack, who: VirtualPeople, space: ErrorSpace, effort: Effort) -> Worst:
    """Search for the worst errors of a space for one person.

    Parameters
    ----------
    attack : Attack
    who : VirtualPeople
        One, see `Attack.one`.
    space : ErrorSpace
    effort : Effort

    Raises
    ------
    ValueError
        If the search library is not installed.
    """
    *_, last = generations(judge_of(attack, who), space, effort)
    return worst_of(attack, who, space, last)


def judge_of(attack: Attack, who: VirtualPeople) -> Judge:
    """Function that gives the harm done to one person."""
    return lambda errors, stuck_from: attack.on_one(who, errors, stuck_from).score


def worst_of(attack: Attack, who: VirtualPeople, space: ErrorSpace, last: Generation) -> Worst:
    """The worst sequence of a search whose last generation is given, with its effect."""
    point = last.best[None]
    errors, stuck_from = space.errors(point)[:, 0], np.sort(space.stuck_from(point)[:, 0])
    lane, harm = attack.trace(who, errors, stuck_from)
    return Worst(
        errors=errors,
        stuck_from=stuck_from,
        below_54_min=float(harm.below_54_min[0]),
        lowest_mg_dl=float(harm.lowest_mg_dl[0]),
        peak_mg_dl=float(harm.peak_mg_dl[0]),
        tried=(last.number + 1) * last.score.size,
        lane=lane,
    )
