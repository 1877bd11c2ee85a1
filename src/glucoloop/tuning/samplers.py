"""Samplers that propose the next tunings of `glucoloop robust`.

A sampler is asked for a round of tunings at a time and gets the result of each, in order. It depends only on its seed,
on the size of a round and on these results, so that an interrupted search resumes by passing them again. One joins the
command by one class, entered in `SAMPLERS` or by the entry point of another package in the group
``glucoloop.samplers``.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Protocol

from glucoloop.component.base import MadeComponent
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.setting import About, Tuned
from glucoloop.refusal import needed_for
from glucoloop.units import LARGEST_SEED


@dataclass(frozen=True)
class Evaluated:
    """Result of a tuning."""

    values: tuple[float, ...]
    """Values of the two objectives; NaN for a tuning without a controller."""
    violation: tuple[float, ...] = ()
    """Relative excess over each bound; 0 or less if the bound is kept."""


class Sampler(Protocol):
    """Protocol of a sampler, which is asked for tunings and gets their results, in turns."""

    def ask(self, number: int) -> list[dict[str, float]]:
        """The next tunings."""

    def tell(self, results: Sequence[Evaluated]) -> None:
        """Take the results of the tunings that were asked for last, in their order."""


class RandomDraws:
    """Sampler of random draws, each uniform between its bounds, or its logarithm; `start` is tried first."""

    def __init__(self, space: Sequence[Tuned], seed: int, start: dict[str, float] | None = None) -> None:
        import numpy as np  # here, since help is shown from this module

        self._space, self._start = space, start
        self._random = np.random.default_rng(seed)

    def ask(self, number: int) -> list[dict[str, float]]:
        """Draw tunings at random."""
        shares = self._random.random((number, len(self._space)))
        points = [
            {setting.name: setting.at(float(share)) for setting, share in zip(self._space, row, strict=True)}
            for row in shares
        ]
        if self._start is not None:
            points[0], self._start = self._start, None
        return points

    def tell(self, results: Sequence[Evaluated]) -> None:
        """Ignore the results, since the draws do not depend on them."""


def tpe(space: Sequence[Tuned], seed: int, batch: int, start: dict[str, float] | None = None) -> Sampler:
    """Sampler by Parzen estimators; the first of the rounds of `batch` tunings is random."""
    return _Optuna(space, start, "TPESampler", seed=seed, multivariate=True, constant_liar=True, n_startup_trials=batch)


def nsga2(space: Sequence[Tuned], seed: int, batch: int, start: dict[str, float] | None = None) -> Sampler:
    """Sampler by NSGA-II with a population of `batch` tunings."""
    return _Optuna(space, start, "NSGAIISampler", seed=seed, population_size=batch)


class _Optuna:
    """Sampler by an Optuna study in memory."""

    def __init__(self, space: Sequence[Tuned], start: dict[str, float] | None, sampler: str, **settings: Any) -> None:
        with needed_for("a sampler other than random"):
            import optuna
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self._optuna, self._space = optuna, space
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what it calls experimental
            made = getattr(optuna.samplers, sampler)(**settings, constraints_func=_violation)
            self._study = optuna.create_study(directions=["minimize", "minimize"], sampler=made)
            if start is not None:
                self._study.enqueue_trial(start)
        self._proposals: list[Any] = []

    def ask(self, number: int) -> list[dict[str, float]]:
        """Ask the study for tunings."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._proposals = [self._study.ask() for _ in range(number)]
            return [
                {
                    setting.name: setting.rounded(
                        trial.suggest_float(setting.name, setting.low, setting.high, log=setting.log)
                    )
                    for setting in self._space
                }
                for trial in self._proposals
            ]

    def tell(self, results: Sequence[Evaluated]) -> None:
        """Pass the results to the study."""
        failed = self._optuna.trial.TrialState.FAIL
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for trial, result in zip(self._proposals, results, strict=True):
                trial.set_user_attr(_VIOLATION, list(result.violation))
                if all(map(math.isfinite, result.values)):
                    self._study.tell(trial, result.values)
                else:
                    self._study.tell(trial, state=failed)


_VIOLATION: Final = "violation"


def _violation(trial: Any) -> Sequence[float]:
    result: Sequence[float] = trial.user_attrs[_VIOLATION]
    return result


class SamplerComponent(MadeComponent):
    """Declaration of a `Sampler`: its name, its settings, and the place of the function that makes it.

    Its function is also given, if it has parameters of these names, ``space`` (a `component.setting.Tuned` for each
    number), ``batch`` (the number of tunings in a round) and ``start`` (the tuning to be tried first, or None).
    """

    kind: ClassVar = "sampler"
    seed: Annotated[int, About("Seed of what it draws.", at_least=0, at_most=LARGEST_SEED)] = 0


class _TPESettings(SamplerComponent, name="tpe"):
    """Parzen estimators of good and of other tunings, by Optuna."""

    make: ClassVar = "glucoloop.tuning.samplers:tpe"


class _NSGA2Settings(SamplerComponent, name="nsga2"):
    """The evolutionary algorithm NSGA-II, by Optuna."""

    make: ClassVar = "glucoloop.tuning.samplers:nsga2"


class _RandomSettings(SamplerComponent, name="random"):
    """Random draws, uniform between the bounds or in the logarithm."""

    make: ClassVar = "glucoloop.tuning.samplers:RandomDraws"


SAMPLERS: Final = Catalogue(
    SamplerComponent,
    {
        "tpe": "glucoloop.tuning.samplers:_TPESettings",
        "nsga2": "glucoloop.tuning.samplers:_NSGA2Settings",
        "random": "glucoloop.tuning.samplers:_RandomSettings",
    },
    example="tpe, seed=3",
    unnamed=True,
)
