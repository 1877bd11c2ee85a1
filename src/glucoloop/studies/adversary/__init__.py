"""Search for the worst plausible sensor errors, which make a controller do the most harm.

A row of it is the harm of all sequences of a generation. A search depends only on its seed and on these rows, so an
interrupted one resumes by reading them again.
"""

from __future__ import annotations

import functools
from typing import Annotated, ClassVar, Final

from glucoloop.component.effects import READINGS, Need
from glucoloop.component.request import Request
from glucoloop.component.setting import Option
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case, cases_of
from glucoloop.studies.guarded import PAPER_CONTROLLERS, PAPER_MEAL, GuardedTrial, Guards
from glucoloop.studies.study import SearchStudy
from glucoloop.units import LARGEST_COUNTER, LARGEST_SEED

_STUCK: Final = Need("no reading is stuck, for --stuck-times is 0")
_errors = functools.partial(Option, panel="Errors")
_search = functools.partial(Option, panel="Search")


class Adversary(GuardedTrial):
    """Searches for the worst sensor errors of the controllers of a trial."""

    kind: ClassVar = "search for the worst errors"
    refused: ClassVar[tuple[str, ...]] = (
        *("traces", "metrics", "design", "shard_people", "meal_size_spread_pct", "meal_time_spread_min", "days"),
        *("exercise_spread_pct", "exercise_time_spread_min"),
        *("warm_up_min", "habits", "scenario", "rescue", "glucagon", "events", "actions"),
    )

    people: int = 1000
    duration_min: float | None = 600.0
    meals: tuple[str, ...] = PAPER_MEAL
    controller: tuple[Request[Case], ...] = cases_of(*PAPER_CONTROLLERS)
    guards: Guards = "with"
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
    stuck_min: Annotated[
        float, _errors("Length of each.", flag="--stuck-for", above=0.0, at_most=1440.0, needs=(_STUCK,))
    ] = 30.0
    person: Annotated[
        int | None,
        _search(
            "Search on this person of the population; the nominal patient by default.",
            at_least=0,
            at_most=LARGEST_COUNTER,
        ),
    ] = None
    generations: Annotated[int, _search("Number of generations of each search.", at_least=1, at_most=1_000_000)] = 300
    starts: Annotated[int, _search("Searches side by side.", at_least=1, at_most=1024)] = 8
    sequences: Annotated[
        int, _search("Number of sequences in a generation, for each start.", at_least=4, at_most=4096)
    ] = 32
    search_seed: Annotated[
        int, _search("The same seed tries the same sequences.", at_least=0, at_most=LARGEST_SEED)
    ] = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.errors_pct or len(set(self.errors_pct)) < len(self.errors_pct):
            sizes = ", ".join(f"{error:g}" for error in self.errors_pct) or "empty"
            raise Refusal(f"--error is {sizes}; give one largest error or more, each once")

    def uses(self) -> frozenset[Need]:
        """Needs that the search meets, whose errors are those of readings, some of them stuck."""
        stuck = {_STUCK} if self.stuck_times else set()
        return super().uses() | {READINGS} | stuck

    @property
    def lanes(self) -> int:
        """Number of sequences in a generation of all starts."""
        return self.starts * self.sequences


ADVERSARY: Final = SearchStudy(
    name="adversary",
    what="a search for the worst errors",
    help=(
        "Search for the worst plausible sensor errors: those by which glucose falls lowest.\n\n"
        "Each reading may be wrong by a part of the true glucose, and a few times the reading is stuck. An evolution "
        "strategy (CMA-ES) tries 77 thousand sequences of errors on one person and keeps those with the most time "
        "below 54 mg/dl. For comparison, random errors of the same size are simulated on a population. By default IMC, "
        "MPC, MPC/SE and NLQDMC/SE are searched, with the guard and 50 g at 50 min. The folder of --out is written "
        "after each generation; after Ctrl-C, the same command continues where it stopped.\n\n"
        "  glucoloop adversary --out worst\n\n"
        "  glucoloop adversary --controller mpc --error 10 --guards both\n\n"
        "  glucoloop adversary --controller mpc --person 17 --error 20 --generations 1000 --out person-17\n\n"
        "  glucoloop adversary --config worst/adversary.toml --out again"
    ),
    module="glucoloop.studies.adversary.study",
    request=Adversary,
    needs_folder=False,
    option_texts={
        "help": {
            "people": "Number of people with random errors, for comparison.",
            "duration_min": "Length of the run.",
            "seed": "The same seed gives the same people and noise.",
            "out": "Folder for figures of the worst loops and tables; an unfinished search in it is resumed.",
        },
        "rare": dict.fromkeys(("setpoint_mg_dl", "announce_meals", "model", "starts", "search_seed"), True),
    },
    results="scores.parquet",
    files=("adversary.csv", "worst.parquet", "worst.pdf", "worst.png", "worst.svg"),
    summary="adversary.json",
)
