"""The search for the worst errors, by the covariance matrix adaptation evolution strategy from many starts.

Each start is a search of its own with a small population; those of all starts are simulated side by side. One without
progress for many generations begins again elsewhere. A search depends only on its seed and on the harm that it was
given, so an interrupted one resumes by passing the harm again.

References
----------
N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772; the library is `cmaes`: M. Nomura, M. Shibata,
"cmaes: a simple yet practical Python library for CMA-ES", arXiv:2402.01373.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop._extras import needed_for
from glucoloop.patients.population import VirtualPeople
from glucoloop.studies.adversary.attack import Attack, Harm, Lane
from glucoloop.studies.adversary.space import ErrorSpace

Array = npt.NDArray[Any]
Judge = Callable[[Array, Array], Array]
"""Harm ``(n,)`` of sequences of errors ``(samples, n)`` with stuck stretches from the samples ``(stretches, n)`` on."""

"""The optional dependency that holds the search."""
_FIRST_STEP: Final = 0.5
"""Standard deviation of the first generation, of a range from -1 to 1."""
_STEP_FROM_KNOWN: Final = 0.1
"""Standard deviation of the first generation of the start that continues from a known sequence."""
_PATIENCE: Final = 60
"""Number of generations without more harm, by `_MORE`, after which a start begins again."""
_MORE: Final = 1e-3


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
                raise ValueError(f"{name} is {value!r}; give a whole number from {least} to {most}")

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


class _Start:
    """One of the searches."""

    def __init__(self, space: ErrorSpace, effort: Effort, number: int, known: Array | None) -> None:
        self._space, self._effort, self._number, self._known = space, effort, number, known
        self._begun, self._most, self._waited = 0, -np.inf, 0
        self._search = self._anew()

    def ask(self) -> Array:
        """Sequences of the next generation, ``(population, dimension)``."""
        points = np.array([self._search.ask() for _ in range(self._effort.population)])
        if self._known is not None:
            points[0], self._known = self._known, None
        return points

    def tell(self, points: Array, score: Array) -> None:
        """Take the harm of the sequences, and begin again if there was no progress for long."""
        # what is not a number is told as the least harm: the library orders numbers alone
        told = np.where(np.isfinite(score), score, np.finfo(float).min)
        self._search.tell([(point, -float(of)) for point, of in zip(points, told, strict=True)])
        most = float(score.max())
        if most > self._most + _MORE:
            self._most, self._waited = most, 0
        else:
            self._waited += 1
        if self._waited > _PATIENCE or self._search.should_stop():
            self._search = self._anew()

    def _anew(self) -> Any:
        """A search around zero error with the stuck stretches anywhere, or at first around a known sequence."""
        entropy = np.random.SeedSequence([self._effort.seed, self._number, self._begun])
        self._begun, self._most, self._waited = self._begun + 1, -np.inf, 0
        stream, of_search = entropy.spawn(2)
        stuck = np.random.default_rng(stream).uniform(-1.0, 1.0, self._space.stretches)
        about, known = np.concatenate([np.zeros(self._space.pieces), stuck]), self._known
        return _import().CMA(
            mean=about if known is None else known,
            sigma=_FIRST_STEP if known is None else _STEP_FROM_KNOWN,
            population_size=self._effort.population,
            seed=int(of_search.generate_state(1)[0]),
        )


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
    starts = [_Start(space, effort, number, known if number == 0 else None) for number in range(effort.starts)]
    best_score, best = -np.inf, np.zeros(space.dimension)
    for number in range(effort.generations):
        asked = [start.ask() for start in starts]
        points = np.concatenate(asked)
        if number < len(before):
            score = np.asarray(before[number], float)
        else:
            score = judge(space.errors(points), space.stuck_from(points))
        most = int(np.argmax(score))
        if score[most] > best_score:
            best_score, best = float(score[most]), points[most]
        for start, of_start, told in zip(starts, asked, np.split(score, effort.starts), strict=True):
            start.tell(of_start, told)
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
    return _worst(errors, stuck_from, lane, harm, (last.number + 1) * last.score.size)


def _worst(errors: Array, stuck_from: Array, lane: Lane, harm: Harm, tried: int) -> Worst:
    return Worst(
        errors=errors,
        stuck_from=stuck_from,
        below_54_min=float(harm.below_54_min[0]),
        lowest_mg_dl=float(harm.lowest_mg_dl[0]),
        peak_mg_dl=float(harm.peak_mg_dl[0]),
        tried=tried,
        lane=lane,
    )


def _import() -> Any:
    with needed_for("the search for the worst errors"):
        import cmaes
    return cmaes
