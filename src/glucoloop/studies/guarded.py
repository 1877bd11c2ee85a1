"""Configuration of a trial whose controllers are tried with a guard, without one, or both, for several studies."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

from glucoloop.cohorts.trial import Trial
from glucoloop.config.cases import CASES_KEY, CONTROLLERS_KEY
from glucoloop.config.trial import overlay_trial, read_trial, trial_keys
from glucoloop.config.unusual import ask_about_settings
from glucoloop.parts.guard import GUARD, complete_guard
from glucoloop.parts.patients import patient_entry
from glucoloop.parts.setting import Value
from glucoloop.refusal import Refusal
from glucoloop.studies.options import Guards

WITH_GUARD: Final[Mapping[Guards, tuple[bool, ...]]] = {"both": (False, True), "with": (True,), "without": (False,)}
"""Whether there is a guard, for each time that a controller is tried."""


def read_guarded_trial(
    keys: Mapping[str, object],
    cases: Sequence[Mapping[str, object]],
    names: Mapping[str, str] | None,
    *,
    what: str,
    usual: Mapping[str, object],
    own: Collection[str],
    refused: Collection[str],
) -> tuple[Trial, Mapping[str, Value]]:
    """Read a trial with a case for each controller, without a guard, and all limits of the guard.

    Parameters
    ----------
    keys, cases, names
        As for `read_trial`, with the limits of the guard among the keys.
    what : str
        The study in messages: ``"a stress test"``.
    usual : mapping
        Keys in place of those that are usual for a trial, its controllers among them.
    own : collection of str
        Keys of the study itself, which are not read here.
    refused : collection of str
        Keys of a trial that the study does not have.

    Raises
    ------
    ValueError
        For a key that is refused, unknown, wrong or at odds with another.
    """
    for key in refused:
        if key in keys:
            raise Refusal(f"{(names or {}).get(key, key)} is no part of {what}; leave it out")
    given = {key: value for key, value in keys.items() if key in GUARD}
    others = {key: value for key, value in keys.items() if key not in GUARD and key not in own}
    named = {} if others.get(CONTROLLERS_KEY) else {CONTROLLERS_KEY: [] if cases else usual[CONTROLLERS_KEY]}
    plain = {**overlay_trial(usual, others, names), **named}
    base = read_trial(plain, cases, names)
    limits = complete_guard(given, patient_entry(base.patient))
    if not base.allow_unusual:
        ask_about_settings(GUARD.values(), given, names)
    return base, limits


def guarded_trial_keys(
    base: Trial, own: Mapping[str, Any], limits: Mapping[str, Value], without: Collection[str]
) -> dict[str, Any]:
    """The flat keys from which the same trial is read, with those of the study; tables stand at the end of a file."""
    trial = {key: value for key, value in trial_keys(base).items() if key not in without}
    cases = trial.pop(CASES_KEY)
    return {**trial, **own, **limits, CASES_KEY: cases}
