"""Robust: a tuning that is good for many people and in noise, and its check on subjects that the search never saw."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from glucoloop.config.key import Key
from glucoloop.config.options.trial import SITUATION_KEYS
from glucoloop.control.catalogue import SEARCHED
from glucoloop.limits import LARGEST_COUNTER, LARGEST_SEED
from glucoloop.studies.options import PAPER_MEAL
from glucoloop.studies.study import SearchStudy

BOTH: Final = "both"
"""Preference for the tuning that is nearest to the best of both objectives."""
RANGES: Final = {of.name: of for of in SEARCHED.searched}
"""Ranges that can be searched, by the name of the setting."""
TAKEN: Final = (
    *("population", "meals", "duration_min"),
    *(
        key
        for key in SITUATION_KEYS
        if key not in ("setpoint_mg_dl", "metrics", "carb_error_pct", "carb_bias_pct", "start", "seed")
    ),
    "known_dead_time",
)
"""Keys that a search has in common with a trial, apart from the settings of the controller."""
_MOST_SUBJECTS: Final = 100_000
_subjects = functools.partial(Key, panel="People and noise")
_check = functools.partial(Key, panel="Check on others")
_search = functools.partial(Key, panel="Search")
_number: Final[dict[str, Any]] = {"at_least": 1, "at_most": _MOST_SUBJECTS}
_first: Final[dict[str, Any]] = {"at_least": 0, "at_most": LARGEST_SEED - _MOST_SUBJECTS}
_people_seed: Final[dict[str, Any]] = {"at_least": 0, "at_most": LARGEST_COUNTER}


@dataclass(frozen=True, kw_only=True)
class RobustSettings:
    """Keys of a search that a trial does not have."""

    people: Annotated[int, _subjects("People of the population.", **_number)] = 40
    people_seed: Annotated[int, _subjects("Seed of those people.", **_people_seed)] = 424242
    seeds: Annotated[int, _subjects("Number of noises of the nominal patient.", **_number)] = 40
    first_seed: Annotated[int, _subjects("Seed of the first noise.", **_first)] = 900_000
    check_people: Annotated[int, _check("People of the check.", **_number)] = 200
    check_people_seed: Annotated[int, _check("Seed of those people.", **_people_seed)] = 424243
    check_seeds: Annotated[int, _check("Noises of the check.", **_number)] = 200
    check_first_seed: Annotated[int, _check("Seed of the first noise.", **_first)] = 950_000
    objectives: Annotated[
        tuple[str, ...],
        _search("One of the two objectives of the front; give it twice.", flag="--objective"),
    ] = ("undershoot-p95", "peak-median")
    at_most: Annotated[
        tuple[str, ...],
        _search(
            "A bound, like total-variation=500, or total-variation=mpc-se: the value of a reference controller; repeat "
            "it for more.",
            metavar="NAME=X",
        ),
    ] = ()
    beside: Annotated[tuple[str, ...], _search("A reference controller with its usual tuning; repeat it for more.")] = (
        "mpc-se",
    )
    sampler: Annotated[
        Literal["tpe", "nsga2", "random"],
        _search("Sampler of the candidates: tpe, Parzen estimators; nsga2, evolution; random, which needs no Optuna."),
    ] = "tpe"
    sampler_seed: Annotated[int, _search("Seed of the sampler.", at_least=0, at_most=LARGEST_SEED)] = 0
    batch: Annotated[int, _search("Number of candidates that are proposed at a time.", at_least=1, at_most=4096)] = 64


@dataclass(frozen=True, kw_only=True)
class HowFar:
    """Keys of the extent of a search, which may differ when it is resumed."""

    rounds: Annotated[int, _search("Number of rounds in all.", at_least=1, at_most=10_000)] = 4
    prefer: Annotated[
        str,
        _search(
            "Choice of a tuning of the front: an objective, for its least value, or both, for the nearest to both.",
            metavar=f"NAME|{BOTH}",
        ),
    ] = BOTH


@dataclass(frozen=True, kw_only=True)
class Shown:
    """Keys of the output of a search, which are no part of its configuration."""

    top: Annotated[int, _search("Number of tunings of the front in the table.", at_least=1)] = 10


_SETTINGS: Final = SEARCHED.settings()

ROBUST: Final = SearchStudy(
    name="robust",
    what="a search",
    help=(
        f"Search for a tuning of {SEARCHED.name} that is good for many people and for noise, and show the trade-off "
        "between two objectives.\n\n"
        "Each candidate tuning is simulated on people of a population, and on the nominal patient with many "
        "realisations of the noise. Two objectives make a Pareto front, and the others can be bounded. The chosen "
        "tuning is checked on people and noise that the search never used, and written as a configuration for "
        "`glucoloop run --config`. A parameter that is tuned is given as a range, .1:2; one number keeps it fixed. The "
        "folder is written after each candidate; after Ctrl-C, the same command continues where it stopped, and with "
        "more --rounds the search continues.\n\n"
        "Objectives are undershoot-median, undershoot-p95, peak-median, peak-p95 and total-variation of the nominal "
        "patient in noise, and people-undershoot-p95, people-peak-p95 and people-below-60.\n\n"
        "  glucoloop robust --out robust\n\n"
        "  glucoloop robust --at-most total-variation=mpc-se --at-most people-below-60=0 --rounds 8 --out robust\n\n"
        "  glucoloop robust --sampler random --move-weight .1:1 --caution-weight 7.5 --out random\n\n"
        "  glucoloop run --noise 1.45 --config robust/best.toml"
    ),
    module="glucoloop.studies.robust.study",
    settings=(RobustSettings, HowFar, Shown),
    taken=(*_SETTINGS, *TAKEN),
    usual={"duration_min": 600.0, "meals": PAPER_MEAL, "noise_variance": 1.45},
    words={
        "help": {
            "duration_min": "Length of the run.",
            "meals": "Carbohydrate and time, like 50g@50min; repeat it for more meals.",
        },
        "panel": {"population": "People and noise", **dict.fromkeys(_SETTINGS, "Tuning")},
        "default": {
            **{name: setting.default.text for name, setting in _SETTINGS.items()},
            **{
                name: of.text if of.unasked else f"kept at {_SETTINGS[name].default.text}"
                for name, of in RANGES.items()
            },
        },
        "metavar": dict.fromkeys(RANGES, "RANGE"),
        "kind": dict.fromkeys(RANGES, str),
    },
    files=("best.toml", "candidates.csv", "check.parquet", "front.pdf", "front.png", "front.svg"),
    summary="robust.json",
    extent=HowFar,
)
