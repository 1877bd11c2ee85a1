"""Configuration of a search for a robust tuning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, Field

from glucoloop.config.run import LARGEST_SEED, STRICT, Run, checked, only, read_run
from glucoloop.config.trial import read_trial, trial_keys
from glucoloop.config.unusual import ALLOW_UNUSUAL
from glucoloop.experiments.case import Case
from glucoloop.registry import controllers as catalogue
from glucoloop.registry.ranges import Tuned, parse_range
from glucoloop.registry.settings import known_names, refuse_unknown_keys
from glucoloop.studies.robust.front import BOTH
from glucoloop.studies.robust.objectives import OBJECTIVES
from glucoloop.studies.robust.search import Group, Search
from glucoloop.threefry import LARGEST_COUNTER

RANGES: Final = {of.name: of for of in catalogue.SEARCHED.searched}
"""Ranges that can be searched, by the name of the setting."""
_SITUATION: Final = (
    "population",
    "patient",
    "operating_point",
    "meals",
    "meal_model",
    "duration_min",
    "announce_meals",
    "noise_variance",
    "noise_bound_mg_dl",
    "dead_time_min",
    "max_change_mU_min",
    "min_insulin_mU_min",
    "max_insulin_mU_min",
    "site",
    "pump_resolution_mU_min",
    "faults",
    "sample_time_min",
    ALLOW_UNUSUAL,
)
"""Keys that a search has in common with a trial."""
_USUAL: Final[Mapping[str, Any]] = {"duration_min": 600.0, "meals": ["50g@50min"], "noise_variance": 1.45}
_CASE: Final = ("known_dead_time",)
_MOST_SUBJECTS: Final = 100_000


class RobustKeys(BaseModel):
    """Keys of a search that a trial does not have."""

    model_config = STRICT

    people: Annotated[int, Field(ge=1, le=_MOST_SUBJECTS)] = 40
    people_seed: Annotated[int, Field(ge=0, le=LARGEST_COUNTER)] = 424242
    seeds: Annotated[int, Field(ge=1, le=_MOST_SUBJECTS)] = 40
    first_seed: Annotated[int, Field(ge=0, le=LARGEST_SEED - _MOST_SUBJECTS)] = 900_000
    check_people: Annotated[int, Field(ge=1, le=_MOST_SUBJECTS)] = 200
    check_people_seed: Annotated[int, Field(ge=0, le=LARGEST_COUNTER)] = 424243
    check_seeds: Annotated[int, Field(ge=1, le=_MOST_SUBJECTS)] = 200
    check_first_seed: Annotated[int, Field(ge=0, le=LARGEST_SEED - _MOST_SUBJECTS)] = 950_000
    objectives: tuple[str, ...] = ("undershoot-p95", "peak-median")
    at_most: tuple[str, ...] = ()
    beside: tuple[str, ...] = ("mpc-se",)
    sampler: Literal["tpe", "nsga2", "random"] = "tpe"
    sampler_seed: Annotated[int, Field(ge=0, le=LARGEST_SEED)] = 0
    batch: Annotated[int, Field(ge=1, le=4096)] = 64


class HowFar(BaseModel):
    """Keys of the extent of a search, which may differ when it is resumed."""

    model_config = STRICT

    rounds: Annotated[int, Field(ge=1, le=10_000)] = 4
    prefer: str = BOTH


@dataclass(frozen=True)
class Robust:
    """A search that is complete and checked."""

    search: Search
    own: RobustKeys
    far: HowFar
    ranges: Mapping[str, str]
    """Ranges of the tuned numbers, as written."""

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same search is read."""
        trial, tuning = trial_keys(self.search.trial), dict(self.search.case.tuning)
        return {
            **self.own.model_dump(mode="json"),
            **self.far.model_dump(mode="json"),
            **{key: trial[key] for key in _SITUATION if key in trial},
            "known_dead_time": self.search.case.known_dead_time,
            **{**tuning, **self.ranges},
        }

    def run_of(self, case: Case) -> Run:
        """A single run of the nominal patient, in the same situation, with a case."""
        keys = trial_keys(self.search.trial)
        shared = {key: keys[key] for key in _SITUATION if key != "population" and keys.get(key) is not None}
        return read_run(
            {**shared, "controller": case.controller, "known_dead_time": case.known_dead_time, **case.tuning}
        )


def robust_key_names() -> list[str]:
    """All flat keys of a search."""
    settings = [setting.name for setting in catalogue.SEARCHED.settings]
    return [*RobustKeys.model_fields, *HowFar.model_fields, *_SITUATION, *_CASE, *settings]


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
    refuse_unknown_keys(keys, known, " of a search")
    own = checked(RobustKeys, only(keys, RobustKeys), names)
    far = checked(HowFar, only(keys, HowFar), names)
    if len(own.objectives) != 2:
        raise ValueError(
            f"{called['objectives']} is {', '.join(own.objectives)}; give two objectives, and others as bounds"
        )
    for name in own.beside:
        catalogue.controller_entry(name)
    tuned = catalogue.SEARCHED.name
    if len(set(own.beside)) < len(own.beside) or tuned in own.beside:
        raise ValueError(
            f"{called.get('beside', 'beside')} is {', '.join(own.beside)}; name each controller once, and "
            f"{tuned} not at all, since it is tuned"
        )
    space, fixed = _space({key: keys[key] for key in RANGES if key in keys}, called)
    settings = {
        of.name: keys[of.name] for of in catalogue.SEARCHED.settings if of.name in keys and of.name not in RANGES
    }
    plain = {**_USUAL, **{key: keys[key] for key in (*_SITUATION, *_CASE) if keys.get(key) is not None}}
    cases = [{"label": tuned, "controller": tuned, **settings, **fixed}]
    cases += [{"label": name, "controller": name} for name in own.beside]
    trial = read_trial({**plain, "people": own.people, "seed": own.people_seed}, cases, names)
    if far.prefer not in (*own.objectives, BOTH):
        raise ValueError(
            f"{called.get('prefer', 'prefer')} is {far.prefer!r}; give {', '.join(own.objectives)} or {BOTH}"
        )
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
    return Robust(search=search, own=own, far=far, ranges={of.name: of.text for of in space})


def _space(told: Mapping[str, object], called: Mapping[str, str]) -> tuple[tuple[Tuned, ...], dict[str, float]]:
    """Ranges of the tuned numbers, and values of the fixed ones."""
    space, fixed = {of.name: of for of in RANGES.values() if of.unasked}, {}
    for key, value in told.items():
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"{called[key]} is {value!r}; write it like '.1:2', or one number that is kept")
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
        raise ValueError(f"{called} is {text!r}; write it like total-variation=500, or total-variation=mpc-se")
    if name not in OBJECTIVES:
        raise ValueError(f"{called} is {text!r}: unknown objective {name!r}; {known_names(name, OBJECTIVES)}")
    try:
        number = float(most)
    except ValueError:
        return name, most
    if number != number:
        raise ValueError(f"{called} is {text!r}; give a number, or the name of a controller that stands beside")
    return name, number
