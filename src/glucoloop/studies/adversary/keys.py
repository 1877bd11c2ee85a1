"""Configuration of a search for the worst sensor errors: a trial, the bounds of the errors, and the effort."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final

from pydantic import BaseModel, Field

from glucoloop.cohorts.trial import Trial
from glucoloop.config.run import STRICT, Seed, checked, only, whole_samples
from glucoloop.registry.controllers import controller_entry
from glucoloop.registry.settings import Value
from glucoloop.studies.adversary.outcome import ErrorSearch
from glucoloop.studies.adversary.search import Effort
from glucoloop.studies.adversary.space import ErrorSpace
from glucoloop.studies.guarded import PAPER_CONTROLLERS, WITH_GUARD, Guards, guarded_trial_keys, read_guarded_trial
from glucoloop.threefry import LARGEST_COUNTER

GENERATIONS: Final = 300
FEW_GENERATIONS: Final = 30
SEARCHED: Final = tuple(name for name in PAPER_CONTROLLERS if not controller_entry(name).slow)
"""Controllers of a search without options; slow ones are searched only when they are named."""
_USUAL: Final[Mapping[str, Any]] = {"people": 1000, "duration_min": 600.0, "meals": ["50g@50min"]}
_REFUSED: Final = ("traces", "guard", "design", "shard_people", "meal_size_spread_pct", "meal_time_spread_min")
_NOT_WRITTEN: Final = (*_REFUSED, "days")


class AdversaryKeys(BaseModel):
    """Keys of a search that a trial does not have."""

    model_config = STRICT

    errors_pct: tuple[Annotated[float, Field(ge=0.0, lt=100.0)], ...] = (10.0, 20.0, 30.0)
    """Largest errors of a reading, in percent of the true glucose; each has a search of its own."""
    hold_min: Annotated[float, Field(gt=0.0, le=1440.0)] = 15.0
    """Time for which an error stays the same."""
    stuck_times: Annotated[int, Field(ge=0, le=100)] = 3
    stuck_min: Annotated[float, Field(gt=0.0, le=1440.0)] = 30.0
    """Length of each stretch in which the reading stays the same."""
    person: Annotated[int, Field(ge=0, le=LARGEST_COUNTER)] | None = None
    """Person of the population, or None for the nominal patient."""
    guards: Guards = "with"
    generations: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Number of generations, or None for `GENERATIONS`, or `FEW_GENERATIONS` for a slow controller."""
    starts: Annotated[int, Field(ge=1, le=1024)] = 8
    sequences: Annotated[int, Field(ge=4, le=4096)] = 32
    """Number of sequences in a generation of each start."""
    search_seed: Seed = 1


@dataclass(frozen=True)
class Adversary:
    """A search that is complete and checked."""

    base: Trial
    """Trial with a case for each controller, without a guard."""
    own: AdversaryKeys
    limits: Mapping[str, Value]
    """All limits of the guard."""

    def _effort(self, controller: str) -> Effort:
        own = self.own
        usual = FEW_GENERATIONS if controller_entry(controller).slow else GENERATIONS
        return Effort(
            generations=own.generations or usual, starts=own.starts, population=own.sequences, seed=own.search_seed
        )

    def groups(self) -> Iterator[tuple[Trial, list[ErrorSearch]]]:
        """Searches that share a loop: those of one controller, guarded or not."""
        trial, own = self.base, self.own
        spaces = [
            ErrorSpace(
                samples=trial.samples,
                error=error / 100.0,
                hold_samples=whole_samples(own.hold_min, trial.sample_time_min, "a time for which an error holds"),
                stretches=own.stuck_times,
                stretch_samples=whole_samples(own.stuck_min, trial.sample_time_min, "a stuck stretch"),
            )
            for error in own.errors_pct
        ]
        for case in trial.cases:
            for guarded in WITH_GUARD[own.guards]:
                tried = dataclasses.replace(case, guard=dict(self.limits) if guarded else None)
                alone = dataclasses.replace(trial, cases=(tried,))
                yield (
                    alone,
                    [ErrorSearch(case=tried, space=space, effort=self._effort(case.controller)) for space in spaces],
                )

    @property
    def lanes(self) -> int:
        """Number of sequences in a generation."""
        return self.own.starts * self.own.sequences

    @property
    def generations(self) -> int:
        """Number of generations of all searches together."""
        return sum(cell.effort.generations for cell in self.cells())

    def cells(self) -> list[ErrorSearch]:
        """All searches, in order."""
        return [cell for _, cells in self.groups() for cell in cells]

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same search is read."""
        return guarded_trial_keys(self.base, self.own.model_dump(mode="json"), self.limits, _NOT_WRITTEN)


def read_adversary(
    keys: Mapping[str, object], cases: Sequence[Mapping[str, object]] = (), names: Mapping[str, str] | None = None
) -> Adversary:
    """Read the configuration of a search from the shared keys and those of each case.

    Parameters
    ----------
    keys, cases, names
        As for `read_trial`; in place of its usual day it is the paper's meal, and its four controllers and the
        meal-aware one.

    Raises
    ------
    ValueError
        For a key that is unknown, wrong or at odds with another.
    """
    own = checked(AdversaryKeys, only(keys, AdversaryKeys), names)
    if not own.errors_pct or len(set(own.errors_pct)) < len(own.errors_pct):
        told = ", ".join(f"{error:g}" for error in own.errors_pct) or "empty"
        called = (names or {}).get("errors_pct", "errors_pct")
        raise ValueError(f"{called} is {told}; give one largest error or more, each once")
    base, limits = read_guarded_trial(
        keys,
        cases,
        names,
        what="a search for the worst errors",
        usual=_USUAL,
        controllers=SEARCHED,
        own=AdversaryKeys.model_fields,
        refused=_REFUSED,
    )
    asked = Adversary(base=base, own=own, limits=limits)
    asked.cells()  # refuses a part of a sample
    return asked
