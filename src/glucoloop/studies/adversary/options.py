"""Keys of a search for the worst sensor errors, and its usual trial."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final

from glucoloop.config.key import Key
from glucoloop.control.catalogue import controller_entry
from glucoloop.limits import LARGEST_COUNTER, LARGEST_SEED
from glucoloop.studies.options import PAPER_CONTROLLERS, PAPER_MEAL, GuardsKey

GENERATIONS: Final = 300
FEW_GENERATIONS: Final = 30
"""Number of generations for a slow controller."""
USUAL: Final[Mapping[str, Any]] = {
    "people": 1000,
    "duration_min": 600.0,
    "meals": PAPER_MEAL,
    # slow ones are searched only when they are named
    "controllers": [name for name in PAPER_CONTROLLERS if not controller_entry(name).slow],
}
"""Usual keys of the trial, where they differ from those of a trial."""
REFUSED: Final = (
    "traces",
    "guard",
    "metrics",
    "design",
    "shard_people",
    "meal_size_spread_pct",
    "meal_time_spread_min",
)
"""Keys of a trial that the search does not have."""
_errors = functools.partial(Key, panel="Errors")
_search = functools.partial(Key, panel="Search")


@dataclass(frozen=True, kw_only=True)
class AdversaryKeys:
    """Keys of a search that a trial does not have."""

    errors_pct: Annotated[
        tuple[float, ...],
        _errors(
            "Largest error of a reading, in percent of the true glucose; repeat it for more, each has a search of its "
            "own.",
            flag="--error",
            at_least=0.0,
            below=100.0,
        ),
    ] = (10.0, 20.0, 30.0)
    hold_min: Annotated[float, _errors("Time for which an error stays the same.", above=0.0, at_most=1440.0)] = 15.0
    stuck_times: Annotated[int, _errors("Number of stretches with a stuck reading.", at_least=0, at_most=100)] = 3
    stuck_min: Annotated[float, _errors("Length of each.", flag="--stuck-for", above=0.0, at_most=1440.0)] = 30.0
    person: Annotated[
        int | None,
        _search(
            "Search on this person of the population; the nominal patient by default.",
            at_least=0,
            at_most=LARGEST_COUNTER,
        ),
    ] = None
    generations: Annotated[
        int | None,
        _search(
            "Number of generations of each search.",
            told=f"{GENERATIONS}; nlqdmc-se, meal-mpc: {FEW_GENERATIONS}",
            at_least=1,
            at_most=1_000_000,
        ),
    ] = None
    starts: Annotated[int, _search("Searches side by side.", at_least=1, at_most=1024)] = 8
    sequences: Annotated[
        int, _search("Number of sequences in a generation, for each start.", at_least=4, at_most=4096)
    ] = 32
    search_seed: Annotated[
        int, _search("The same seed tries the same sequences.", at_least=0, at_most=LARGEST_SEED)
    ] = 1
    guards: GuardsKey = "with"
