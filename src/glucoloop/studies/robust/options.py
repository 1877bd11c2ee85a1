"""Keys of a search for a robust tuning, and its usual trial."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from glucoloop.config.key import Key
from glucoloop.config.options.trial import SITUATION_KEYS
from glucoloop.control.catalogue import SEARCHED
from glucoloop.limits import LARGEST_COUNTER, LARGEST_SEED
from glucoloop.studies.options import PAPER_MEAL

BOTH: Final = "both"
"""Preference for the tuning that is nearest to the best of both objectives."""
RANGES: Final = {of.name: of for of in SEARCHED.searched}
"""Ranges that can be searched, by the name of the setting."""
NOT_SHARED: Final = ("setpoint_mg_dl", "metrics", "carb_error_pct", "carb_bias_pct", "start", "seed")
TAKEN: Final = (
    *("population", "meals", "duration_min"),
    *(key for key in SITUATION_KEYS if key not in NOT_SHARED),
)
"""Keys that a search has in common with a trial."""
USUAL: Final[Mapping[str, Any]] = {"duration_min": 600.0, "meals": PAPER_MEAL, "noise_variance": 1.45}
"""Usual keys of the trial, where they differ from those of a trial."""
SUBJECTS_PANEL: Final = "People and noise"
SEARCH_PANEL: Final = "Search"
_MOST_SUBJECTS: Final = 100_000
_subjects = functools.partial(Key, panel=SUBJECTS_PANEL)
_check = functools.partial(Key, panel="Check on others")
_search = functools.partial(Key, panel=SEARCH_PANEL)
_number: Final[dict[str, Any]] = {"at_least": 1, "at_most": _MOST_SUBJECTS}
_first: Final[dict[str, Any]] = {"at_least": 0, "at_most": LARGEST_SEED - _MOST_SUBJECTS}
_people_seed: Final[dict[str, Any]] = {"at_least": 0, "at_most": LARGEST_COUNTER}


@dataclass(frozen=True, kw_only=True)
class RobustKeys:
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
