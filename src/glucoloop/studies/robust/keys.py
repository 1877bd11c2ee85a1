"""Configuration of a search for a robust tuning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys, plain
from glucoloop.config.run import Run, read_run, refuse_unknown_beside
from glucoloop.config.trial import read_trial, trial_keys, with_people
from glucoloop.control import catalogue
from glucoloop.parts.number_text import number_of
from glucoloop.parts.ranges import Tuned, parse_range
from glucoloop.parts.setting import known_names
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case
from glucoloop.studies.robust.objectives import OBJECTIVES
from glucoloop.studies.robust.options import BOTH, RANGES, TAKEN, USUAL, HowFar, RobustKeys
from glucoloop.studies.robust.search import Group, Search
from glucoloop.tuning.samplers import library

_CASE: Final = ("known_dead_time",)


@dataclass(frozen=True)
class Robust:
    """A search that is complete and checked."""

    search: Search
    own: RobustKeys
    far: HowFar
    ranges: Mapping[str, str]
    """Ranges of the tuned numbers, as written."""
    given: Mapping[str, Any] | None = field(default=None, compare=False)
    """Keys from which it was read, if it was."""

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same search is read."""
        trial, tuning = trial_keys(self.search.trial), dict(self.search.case.tuning)
        return {
            **plain(self.own),
            **plain(self.far),
            **{key: trial[key] for key in TAKEN if key in trial},
            "known_dead_time": self.search.case.known_dead_time,
            **{**tuning, **self.ranges},
        }

    def run_of(self, case: Case) -> Run:
        """A single run of the nominal patient, in the same situation, with a case."""
        keys = trial_keys(self.search.trial)
        shared = {key: keys[key] for key in TAKEN if key != "population" and keys.get(key) is not None}
        return read_run(
            {**shared, "controller": case.controller, "known_dead_time": case.known_dead_time, **case.tuning}
        )


def robust_key_names() -> list[str]:
    """All flat keys of a search."""
    settings = list(catalogue.SEARCHED.settings())
    return [*declared(RobustKeys), *declared(HowFar), *TAKEN, *_CASE, *settings]


def read_robust(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Robust:
    """Read the configuration of a search from flat keys.

    Parameters
    ----------
    keys : mapping
        A number that can be tuned is a range, ``"0.1:2"``, or one number, which is kept.
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For a key that is unknown, wrong or at odds with another.
    """
    known, called = robust_key_names(), {key: (names or {}).get(key, key) for key in keys}
    refuse_unknown_beside(keys, known, " of a search")
    own = checked(RobustKeys, own_keys(keys, RobustKeys), names)
    far = checked(HowFar, own_keys(keys, HowFar), names)
    if len(own.objectives) != 2:
        raise Refusal(
            f"{called['objectives']} is {', '.join(own.objectives)}; give two objectives, and others as bounds"
        )
    for name in own.beside:
        catalogue.controller_entry(name)
    tuned = catalogue.SEARCHED.name
    if len(set(own.beside)) < len(own.beside) or tuned in own.beside:
        raise Refusal(
            f"{called.get('beside', 'beside')} is {', '.join(own.beside)}; name each controller once, and "
            f"{tuned} not at all, since it is tuned"
        )
    space, fixed = _space({key: keys[key] for key in RANGES if key in keys}, called)
    settings = {name: keys[name] for name in catalogue.SEARCHED.settings() if name in keys and name not in RANGES}
    plain = {**USUAL, **{key: keys[key] for key in (*TAKEN, *_CASE) if keys.get(key) is not None}}
    cases = [{"label": tuned, "controller": tuned, **settings, **fixed}]
    cases += [{"label": name, "controller": name} for name in own.beside]
    trial = read_trial({**plain, "people": own.people, "seed": own.people_seed}, cases, names)
    if far.prefer not in (*own.objectives, BOTH):
        raise Refusal(f"{called.get('prefer', 'prefer')} is {far.prefer!r}; give {', '.join(own.objectives)} or {BOTH}")
    search = Search(
        trial=trial,
        space=space,
        group=Group(own.people, own.people_seed, own.seeds, own.first_seed),
        check=Group(own.check_people, own.check_people_seed, own.check_seeds, own.check_first_seed),
        objectives=(own.objectives[0], own.objectives[1]),
        at_most=tuple(_bound(text, called.get("at_most", "at_most")) for text in own.at_most),
        batch=own.batch,
        sampler=own.sampler,
        sampler_seed=own.sampler_seed,
    )
    if own.sampler != "random":
        library()
    ranges, given = {of.name: of.text for of in space}, with_people(keys, trial.population)
    return Robust(search=search, own=own, far=far, ranges=ranges, given=given)


def _space(told: Mapping[str, object], called: Mapping[str, str]) -> tuple[tuple[Tuned, ...], dict[str, float]]:
    """Ranges of the tuned numbers, and values of the fixed ones."""
    space, fixed = {of.name: of for of in RANGES.values() if of.unasked}, {}
    for key, value in told.items():
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise Refusal(f"{called[key]} is {value!r}; write it like '.1:2', or one number that is kept")
        read = parse_range(value, RANGES[key], called[key]) if isinstance(value, str) else float(value)
        if isinstance(read, Tuned):
            space[key] = read
        else:
            space.pop(key, None)
            fixed[key] = read
    return tuple(space[name] for name in RANGES if name in space), fixed


def _bound(text: str, called: str) -> tuple[str, float | str]:
    name, equals, most = (part.strip() for part in text.partition("="))
    if not equals or not most:
        raise Refusal(f"{called} is {text!r}; write it like total-variation=500, or total-variation=mpc-se")
    if name not in OBJECTIVES:
        raise Refusal(f"{called} is {text!r}: unknown objective {name!r}; {known_names(name, OBJECTIVES)}")
    try:
        number = number_of(most, float)
    except ValueError:
        return name, most
    if number != number:
        raise Refusal(f"{called} is {text!r}; give a number, or the name of a controller that stands beside")
    return name, number
