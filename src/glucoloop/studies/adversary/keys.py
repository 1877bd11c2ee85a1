"""Configuration of a search for the worst sensor errors: a trial, the bounds of the errors, and the effort."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.cohorts.trial import Trial
from glucoloop.config.cases import given_with
from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys, plain
from glucoloop.config.options.situation import whole_samples
from glucoloop.config.trial import with_people
from glucoloop.control.catalogue import controller_entry
from glucoloop.parts.setting import Value
from glucoloop.refusal import Refusal
from glucoloop.studies.adversary.options import FEW_GENERATIONS, GENERATIONS, REFUSED, USUAL, AdversaryKeys
from glucoloop.studies.adversary.outcome import ErrorSearch
from glucoloop.studies.adversary.search import Effort
from glucoloop.studies.adversary.space import ErrorSpace
from glucoloop.studies.guarded import WITH_GUARD, guarded_trial_keys, read_guarded_trial
from glucoloop.tuning.evolution import library

_NOT_WRITTEN: Final = (*REFUSED, "days")


@dataclass(frozen=True)
class Adversary:
    """A search that is complete and checked."""

    base: Trial
    """Trial with a case for each controller, without a guard."""
    own: AdversaryKeys
    limits: Mapping[str, Value]
    """All limits of the guard."""
    given: Mapping[str, Any] | None = field(default=None, compare=False)
    """Keys from which it was read, if it was."""

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
        return guarded_trial_keys(self.base, plain(self.own), self.limits, _NOT_WRITTEN)


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
    own = checked(AdversaryKeys, own_keys(keys, AdversaryKeys), names)
    if not own.errors_pct or len(set(own.errors_pct)) < len(own.errors_pct):
        told = ", ".join(f"{error:g}" for error in own.errors_pct) or "empty"
        called = (names or {}).get("errors_pct", "errors_pct")
        raise Refusal(f"{called} is {told}; give one largest error or more, each once")
    base, limits = read_guarded_trial(
        keys,
        cases,
        names,
        what="a search for the worst errors",
        usual=USUAL,
        own=declared(AdversaryKeys),
        refused=REFUSED,
    )
    given = given_with(with_people(keys, base.population), cases)
    asked = Adversary(base=base, own=own, limits=limits, given=given)
    asked.cells()  # refuses a part of a sample
    library()
    return asked
