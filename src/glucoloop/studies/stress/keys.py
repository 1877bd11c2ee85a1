"""A stress test from flat keys: a trial, the faults that are tried one at a time, and whether there is a guard."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from glucoloop.cohorts.trial import Trial
from glucoloop.config.cases import CASES_KEY, CONTROLLERS_KEY
from glucoloop.config.run import faults_told
from glucoloop.config.trial import overlay_trial, read_trial, trial_keys
from glucoloop.config.unusual import ask_about_settings
from glucoloop.registry.guard import GUARD, complete_guard
from glucoloop.registry.settings import Value
from glucoloop.studies.stress.stress import STANDARD_FAULTS, Guards, Stress, stress_of

PAPER_CONTROLLERS: Final = ("imc", "mpc", "mpc-se", "nlqdmc-se")
GUARDS: Final[tuple[Guards, ...]] = ("both", "with", "without")
STRESS_KEYS: Final = ("faults", "guards", *GUARD)
"""What a stress test has, and a trial has not or means otherwise."""
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
    """With a case for each controller, free of faults."""
    faults: tuple[str, ...]
    guards: Guards
    limits: Mapping[str, Value]
    """Of the guard, in full."""

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same test is read."""
        keys = {key: value for key, value in trial_keys(self.base).items() if key not in _REFUSED}
        # tables stand at the end of a file
        cases = keys.pop(CASES_KEY)
        return {**keys, "faults": list(self.faults), "guards": self.guards, **self.limits, CASES_KEY: cases}


def read_stress(
    keys: Mapping[str, object], cases: Sequence[Mapping[str, object]] = (), names: Mapping[str, str] | None = None
) -> StressTest:
    """Stress test from the keys that hold for all cases, and those of each.

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
    for key in _REFUSED:
        if key in keys:
            raise ValueError(f"{called[key]} is no part of a stress test; leave it out")
    guards = keys.get("guards", "both")
    if guards not in GUARDS:
        raise ValueError(f"{called['guards']} is {guards!r}; give {', '.join(GUARDS[:-1])} or {GUARDS[-1]}")
    given = {key: value for key, value in keys.items() if key in GUARD}
    limits = complete_guard(given)
    plain = overlay_trial(_USUAL, {key: value for key, value in keys.items() if key not in STRESS_KEYS}, names)
    if not cases and not plain.get(CONTROLLERS_KEY):
        plain[CONTROLLERS_KEY] = list(PAPER_CONTROLLERS)
    base = read_trial(plain, cases, names)
    if not base.allow_unusual:
        ask_about_settings(GUARD.values(), given, names)
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
