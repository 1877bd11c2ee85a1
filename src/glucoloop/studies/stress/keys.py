"""Configuration of a stress test: a trial, the faults that are tried one at a time, and the guard."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from glucoloop.cohorts.trial import Trial
from glucoloop.config.run import faults_told
from glucoloop.registry.settings import Value
from glucoloop.studies.guarded import PAPER_CONTROLLERS, WITH_GUARD, Guards, guarded_trial_keys, read_guarded_trial
from glucoloop.studies.stress.stress import STANDARD_FAULTS, Stress, stress_of

GUARDS: Final = tuple(WITH_GUARD)
STRESS_KEYS: Final = ("faults", "guards")
"""Keys of a stress test that a trial does not have, or that have another meaning here."""
_USUAL: Final[Mapping[str, Any]] = {
    "people": 100,
    "duration_min": 600.0,
    "meals": ["50g@50min"],
    "noise_variance": 1.45,
}
_SHARD_PEOPLE: Final = 128
_REFUSED: Final = ("traces", "guard")


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

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same test is read."""
        own = {"faults": list(self.faults), "guards": self.guards}
        return guarded_trial_keys(self.base, own, self.limits, _REFUSED)


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
    called = {key: (names or {}).get(key, key) for key in keys}
    guards = keys.get("guards", "both")
    if guards not in GUARDS:
        raise ValueError(f"{called['guards']} is {guards!r}; give {', '.join(GUARDS[:-1])} or {GUARDS[-1]}")
    base, limits = read_guarded_trial(
        keys,
        cases,
        names,
        what="a stress test",
        usual=_USUAL,
        controllers=PAPER_CONTROLLERS,
        own=STRESS_KEYS,
        refused=_REFUSED,
    )
    if "shard_people" not in keys:
        # Slow controllers under many faults: so that not much is lost when a run is cut short.
        base = dataclasses.replace(base, shard_people=min(base.people, _SHARD_PEOPLE))
    faults = _faults(keys.get("faults"), called.get("faults", "faults"), base)
    return StressTest(
        stress=stress_of(base, faults, guards, limits), base=base, faults=faults, guards=guards, limits=limits
    )


def _faults(told: object, name: str, base: Trial) -> tuple[str, ...]:
    if told is None:
        return faults_told(STANDARD_FAULTS, base.plan.horizon_min)
    if not isinstance(told, list | tuple) or not told or not all(isinstance(text, str) for text in told):
        raise ValueError(f"{name} is {told!r}; give a list of faults, like ['missing, start_min=60, duration_min=30']")
    return faults_told(told, base.plan.horizon_min, allow_unusual=base.allow_unusual)
