"""The search for the worst errors of one person: generation after generation, from the harm of the one before."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from glucoloop.patients.population import VirtualPeople
from glucoloop.studies.adversary import GENERATIONS, Adversary
from glucoloop.studies.adversary.attack import Array, Attack, ErrorSpace, Harm
from glucoloop.tuning.evolution import Evolution

Judge = Callable[[Array, Array], Array]
"""Harm ``(n,)`` of sequences of errors ``(samples, n)`` with stuck stretches from the samples ``(stretches, n)`` on."""


@dataclass(frozen=True)
class Generation:
    """One generation of all starts: the harm of each sequence, and the most harmful sequence so far."""

    number: int
    score: Array
    best_score: float
    best: Array


@dataclass(frozen=True)
class Worst:
    """The worst of the sequences that were tried: errors relative to the true glucose, and their effect."""

    errors: Array
    stuck_from: Array
    """(stretches,) number of the sample at which each stretch begins, in order."""
    harm: Harm
    loop: pl.DataFrame
    """Course of the loop, see `Attack.trace`."""
    sequences: int
    """Number of sequences that were tried."""


def generations(
    judge: Judge, space: ErrorSpace, effort: Adversary, before: Sequence[Array] = (), known: Array | None = None
) -> Iterator[Generation]:
    """Yield the generations of a search, each as soon as it is known; Refusal without the library of the search.

    Those whose scores are `before` are not simulated again. The sequence `known` is tried first, and one of the starts
    continues from it: the worst of smaller errors, so that the harm found for larger ones is never less.
    """
    sampler = Evolution(
        space.centre, starts=effort.starts, population=effort.sequences, seed=effort.search_seed, known=known
    )
    best_score, best = -np.inf, np.zeros(space.dimension)
    for number in range(effort.generations or GENERATIONS):
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


def worst_errors(attack: Attack, who: VirtualPeople, space: ErrorSpace, effort: Adversary) -> Worst:
    """Search for the worst errors of a space for one person, see `Attack.person` and `generations`."""
    *_, last = generations(judge_of(attack, who), space, effort)
    return worst_of(attack, who, space, last)


def judge_of(attack: Attack, who: VirtualPeople) -> Judge:
    """Function that gives the harm done to one person."""
    return lambda errors, stuck_from: attack.harm(who, errors, stuck_from).score


def worst_of(attack: Attack, who: VirtualPeople, space: ErrorSpace, last: Generation) -> Worst:
    """The worst sequence of a search whose last generation is given, with its effect."""
    point = last.best[None]
    errors, stuck_from = space.errors(point)[:, 0], np.sort(space.stuck_from(point)[:, 0])
    loop, harm = attack.trace(who, errors, stuck_from)
    return Worst(errors, stuck_from, harm, loop, (last.number + 1) * last.score.size)


def random_errors(attack: Attack, space: ErrorSpace, people: int, seed: int) -> Harm:
    """Harm of random errors to the people of a population with a basal rate, as a comparison for that of a search.

    Each person's errors are drawn uniformly from the space.
    """
    who = attack.people(people)
    points = space.random_points(seed, who.draw.person)
    return attack.harm(who, space.errors(points), space.stuck_from(points))
