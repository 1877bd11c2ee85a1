"""Sampler of points by the covariance matrix adaptation evolution strategy, from several starts side by side.

Each start is a search of its own with a small population. One without progress for many generations begins again
elsewhere. The points depend only on the seed and on the given scores, so an interrupted search resumes by passing
them again.

References
----------
N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772; the library is `cmaes`: M. Nomura, M. Shibata,
"cmaes: a simple yet practical Python library for CMA-ES", arXiv:2402.01373.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import needed_for

Array = npt.NDArray[Any]

_FIRST_STEP: Final = 0.5
"""Standard deviation of the first generation, of a range from -1 to 1."""
_STEP_FROM_START: Final = 0.1
"""Standard deviation of the first generation of the start that continues from a known point."""
_PATIENCE: Final = 60
"""Number of generations without a higher score, by `_MORE`, after which a start begins again."""
_MORE: Final = 1e-3


class Evolution:
    """Points of the maximum score, asked for a generation at a time.

    Each of the searches side by side begins around a point that `centre` draws, from -1 to 1 in each coordinate. A
    `start_point` is tried first, and the first search continues from it.
    """

    def __init__(
        self,
        centre: Callable[[np.random.Generator], Array],
        *,
        starts: int,
        population: int,
        seed: int,
        start_point: Array | None = None,
    ) -> None:
        self._starts = [
            _Start(centre, population, (seed, number), start_point if number == 0 else None) for number in range(starts)
        ]

    def ask(self) -> Array:
        """Points of the next generation, ``(starts * population, dimension)``."""
        return np.concatenate([start.ask() for start in self._starts])

    def tell(self, score: Array) -> None:
        """Take the score of each point that was asked for last; NaN counts as the minimum."""
        for start, scores in zip(self._starts, np.split(score, len(self._starts)), strict=True):
            start.tell(scores)


class _Start:
    """One of the searches."""

    def __init__(
        self,
        centre: Callable[[np.random.Generator], Array],
        population: int,
        identity: tuple[int, int],
        start_point: Array | None,
    ) -> None:
        self._centre, self._population, self._identity, self._start_point = centre, population, identity, start_point
        self._begun, self._most, self._waited = 0, -np.inf, 0
        self._search = self._anew()
        self._proposals = np.zeros((0, 0))

    def ask(self) -> Array:
        """Points of the next generation, ``(population, dimension)``."""
        self._proposals = np.array([self._search.ask() for _ in range(self._population)])
        if self._start_point is not None:
            self._proposals[0], self._start_point = self._start_point, None
        return self._proposals

    def tell(self, score: Array) -> None:
        """Take the scores, and begin again if there was no progress for long."""
        # the library orders numbers alone
        finite = np.where(np.isfinite(score), score, np.finfo(float).min)
        self._search.tell([(point, -float(value)) for point, value in zip(self._proposals, finite, strict=True)])
        most = float(score.max())
        if most > self._most + _MORE:
            self._most, self._waited = most, 0
        else:
            self._waited += 1
        if self._waited > _PATIENCE or self._search.should_stop():
            self._search = self._anew()

    def _anew(self) -> Any:
        """A search around a centre, or at first around the known point."""
        entropy = np.random.SeedSequence([*self._identity, self._begun])
        self._begun, self._most, self._waited = self._begun + 1, -np.inf, 0
        stream, of_search = entropy.spawn(2)
        centre, start_point = self._centre(np.random.default_rng(stream)), self._start_point
        return library().CMA(
            mean=centre if start_point is None else start_point,
            sigma=_FIRST_STEP if start_point is None else _STEP_FROM_START,
            population_size=self._population,
            seed=int(of_search.generate_state(1)[0]),
        )


def library() -> Any:
    """The library of the search, asked for before a search that would do other things first."""
    with needed_for("the search for the worst errors"):
        import cmaes
    return cmaes
