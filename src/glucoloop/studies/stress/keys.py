"""Configuration of a stress test: a trial, the faults that are tried one at a time, and the guard."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.cohorts.trial import Trial
from glucoloop.config.cases import given_with
from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys
from glucoloop.config.run import faults_told
from glucoloop.config.trial import with_people
from glucoloop.parts.setting import Value
from glucoloop.refusal import Refusal
from glucoloop.studies.guarded import guarded_trial_keys, read_guarded_trial
from glucoloop.studies.options import Guards
from glucoloop.studies.stress.options import REFUSED, USUAL, StressKeys
from glucoloop.studies.stress.stress import STANDARD_FAULTS, Stress, stress_of

_SHARD_PEOPLE: Final = 128


@dataclass(frozen=True)
class StressTest:
    """A stress test that is complete and checked."""

    stress: Stress
    base: Trial
    """Trial with a case for each controller, without faults."""
    faults: tuple[str, ...]
    guards: Guards
    limits: Mapping[str, Value]
    """All limits of the guard."""
    given: Mapping[str, Any] | None = field(default=None, compare=False)
    """Keys from which it was read, if it was."""

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same test is read."""
        own = {"faults": list(self.faults), "guards": self.guards}
        return guarded_trial_keys(self.base, own, self.limits, REFUSED)


def read_stress(
    keys: Mapping[str, object], cases: Sequence[Mapping[str, object]] = (), names: Mapping[str, str] | None = None
) -> StressTest:
    """Read the configuration of a stress test from the shared keys and those of each case.

    Parameters
    ----------
    keys, cases, names
        As for `read_trial`; in place of its usual day it is the paper's meal with noise, and its four controllers.

    Raises
    ------
    ValueError
        For a key that is unknown, wrong or at odds with another.
    """
    own = checked(StressKeys, own_keys(keys, StressKeys), names)
    base, limits = read_guarded_trial(
        keys,
        cases,
        names,
        what="a stress test",
        usual=USUAL,
        own=declared(StressKeys),
        refused=REFUSED,
    )
    if "shard_people" not in keys:
        # Slow controllers under many faults: so that not much is lost when a run is cut short.
        base = dataclasses.replace(base, shard_people=min(base.people, _SHARD_PEOPLE))
    horizon_min = base.plan.horizon_min
    if own.faults is None:
        faults = faults_told(STANDARD_FAULTS, horizon_min)
    elif not own.faults:
        called = (names or {}).get("faults", "faults")
        raise Refusal(f"{called} is []; give a list of faults, like ['missing, start_min=60, duration_min=30']")
    else:
        faults = faults_told(own.faults, horizon_min, allow_unusual=base.allow_unusual)
    tested = stress_of(base, faults, own.guards, limits)
    given = given_with(with_people(keys, base.population), cases)
    return StressTest(stress=tested, base=base, faults=faults, guards=own.guards, limits=limits, given=given)
