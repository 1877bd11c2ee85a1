"""Robust: a tuning that is good for many people and in noise, and its check on subjects that the search never saw."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final

from glucoloop.component.effects import Need
from glucoloop.component.grammar import Tree
from glucoloop.component.request import Request, by_default
from glucoloop.component.setting import About, Option, Tuned, parse_range
from glucoloop.control.catalogue import CONTROLLERS, SEARCHED
from glucoloop.refusal import Refusal
from glucoloop.sensors import SensorComponent, WhiteNoise
from glucoloop.situations.case import RANGES as RANGES_KEY
from glucoloop.situations.case import Case, cases_of, ranges_parted, with_ranges
from glucoloop.studies.guarded import PAPER_MEAL
from glucoloop.studies.study import SearchStudy
from glucoloop.trials.trial import Trial
from glucoloop.tuning.samplers import SAMPLERS, SamplerComponent
from glucoloop.units import LARGEST_COUNTER, LARGEST_SEED, number_of

BOTH: Final = "both"
"""Preference for the tuning that is nearest to the best of both objectives."""
RANGES: Final = {setting.name: setting for setting in CONTROLLERS[SEARCHED].searched}
"""Ranges that can be searched, by the name of the setting."""
_MAX_SUBJECTS: Final = 100_000
_subjects = functools.partial(Option, panel="People and noise")
_check = functools.partial(Option, panel="Check on others")
_search = functools.partial(Option, panel="Search")
_NOISE: Final = Need("nothing is drawn at random in a run of the nominal patient")
_number: Final[dict[str, Any]] = {"at_least": 1, "at_most": _MAX_SUBJECTS}
_first: Final[dict[str, Any]] = {"at_least": 0, "at_most": LARGEST_SEED - _MAX_SUBJECTS}
_people_seed: Final[dict[str, Any]] = {"at_least": 0, "at_most": LARGEST_COUNTER}


class Search(Trial):
    """A search for a robust tuning: a trial whose first case is tuned, and how the search goes on."""

    kind: ClassVar = "search for a robust tuning"
    refused: ClassVar[tuple[str, ...]] = (
        *(
            "setpoint_mg_dl",
            "metrics",
            "announce_before_min",
            "carb_error_pct",
            "carb_bias_pct",
            "start",
            "seed",
            "first_person",
            "days",
        ),
        *("meal_size_spread_pct", "meal_time_spread_min", "design", "traces", "precision", "arithmetic"),
        *("shard_people", "guard", "model", "rhythm", "exercise", "exercise_spread_pct", "exercise_time_spread_min"),
        *("warm_up_min", "habits", "scenario", "rescue", "glucagon", "events", "actions"),
    )

    duration_min: float | None = 600.0
    meals: tuple[str, ...] = PAPER_MEAL
    sensor: tuple[SensorComponent, ...] = (by_default(WhiteNoise, variance=1.45),)
    controller: tuple[Request[Case], ...] = cases_of(SEARCHED)
    ranges: Annotated[Any, About("Ranges of the tuned settings, which stand among the settings of the controller.")] = (
        None
    )
    people: Annotated[int, _subjects("People of the population.", **_number)] = 40
    people_seed: Annotated[int, _subjects("Seed of those people.", **_people_seed)] = 424242
    seeds: Annotated[int, _subjects("Number of noises of the nominal patient.", **_number, needs=(_NOISE,))] = 40
    first_seed: Annotated[int, _subjects("Seed of the first noise.", **_first, needs=(_NOISE,))] = 900_000
    check_people: Annotated[int, _check("People of the check.", **_number)] = 200
    check_people_seed: Annotated[int, _check("Seed of those people.", **_people_seed)] = 424243
    check_seeds: Annotated[int, _check("Noises of the check.", **_number, needs=(_NOISE,))] = 200
    check_first_seed: Annotated[int, _check("Seed of the first noise.", **_first, needs=(_NOISE,))] = 950_000
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
    beside: Annotated[
        tuple[str, ...], _search("A reference controller with its default tuning; repeat it for more.")
    ] = ("mpc-se",)
    sampler: Annotated[
        SamplerComponent,
        _search("Sampler of the candidates: tpe, nsga2 or random, which needs no Optuna.", default=SAMPLERS.default),
    ] = by_default(SAMPLERS[SAMPLERS.default])
    batch: Annotated[int, _search("Number of candidates that are proposed at a time.", at_least=1, at_most=4096)] = 64
    rounds: Annotated[int, _search("Number of rounds in all.", at_least=1, at_most=10_000)] = 4
    prefer: Annotated[
        str,
        _search(
            "Choice of a tuning of the front: an objective, for its minimum value, or both, for the nearest to both.",
            metavar=f"NAME|{BOTH}",
        ),
    ] = BOTH
    top: Annotated[int, _search("Number of tunings of the front in the table.", at_least=1)] = 10

    @classmethod
    def prepared(cls, tree: Mapping[str, Any]) -> Tree:
        """A tree whose ranges stand apart from the controller."""
        return ranges_parted(tree, RANGES, always=False)

    def tree(self, *, whole: bool = False) -> Tree:
        """Given settings, or all that are used, with the ranges among the settings of the controller."""
        results = super().tree(whole=whole)
        ranges = (
            {setting.name: setting.text for setting in self.space} if whole else self.explicit.get(RANGES_KEY) or {}
        )
        return with_ranges(results, ranges)

    def uses(self) -> frozenset[Need]:
        """Needs that the trial meets, by the reference controllers too."""
        beside = (CONTROLLERS.find(name)().uses() for name in self.beside)
        return super().uses().union(*beside, {_NOISE} if self.noisy or self.drawn_otherwise else ())

    def __post_init__(self) -> None:
        super().__post_init__()
        name = self.case.controller.display_name
        if self.case.controller.name != SEARCHED:
            raise Refusal(f"the controller {name} has no ranges to search; give {SEARCHED}")
        self._refuse_shared_subjects()
        if len(set(self.objectives)) != 2 or len(self.objectives) != 2:
            listed = ", ".join(self.objectives)
            raise Refusal(
                f"--objective is {listed}; give two objectives that differ, and others as bounds by --at-most"
            )
        if self.prefer not in (*self.objectives, BOTH):
            raise Refusal(f"--prefer is {self.prefer!r}; give {', '.join(self.objectives)} or {BOTH}")
        for other in self.beside:
            CONTROLLERS.find(other)
        if len(set(self.beside)) < len(self.beside) or SEARCHED in self.beside:
            raise Refusal(
                f"--beside is {', '.join(self.beside)}; name each controller once, and {SEARCHED} not at all, "
                "since it is tuned"
            )
        _ = self.space, self.bounds  # each refuses what is not possible

    def _refuse_shared_subjects(self) -> None:
        if self.people_seed == self.check_people_seed:
            raise Refusal(
                f"people are drawn with the seed {self.people_seed} for the search and for the check; "
                "give another seed for one of them"
            )
        searched, of_check = (self.first_seed, self.seeds), (self.check_first_seed, self.check_seeds)
        (first, seeds), (second, _) = sorted((searched, of_check))
        if first + seeds > second:
            raise Refusal(
                f"the noise of seed {second} is met in the search and in the check; move the first seed of one of them"
            )

    @functools.cached_property
    def space(self) -> tuple[Tuned, ...]:
        """Ranges of the tuned numbers: those that are given, and the default ones unless one number is given."""
        ranges, fixed = self.ranges or {}, self.case.controller.explicit
        results = []
        for name, default in RANGES.items():
            if name in ranges:
                read = parse_range(ranges[name], default)
                if not isinstance(read, Tuned):
                    raise Refusal(f"{name} is {ranges[name]!r}; write it like .1:2, or one number that is kept")
                results.append(read)
            elif name not in fixed and default.by_default:
                results.append(default)
        if not results:
            raise Refusal("nothing is tuned; give at least one range, like .1:2, in place of a number")
        return tuple(results)

    @functools.cached_property
    def bounds(self) -> tuple[tuple[str, float | str], ...]:
        """Objectives with a bound: a number, or the name of a reference controller."""
        return tuple(_bound(text, self.beside) for text in self.at_most)

    @functools.cached_property
    def trial(self) -> Trial:
        """The situation; its first case is tuned, and the others are references."""
        tuned = dataclasses.replace(self.case, label=self.case.controller.display_name)
        return self.with_cases((tuned, *cases_of(*self.beside)), seed=self.people_seed)

    @property
    def tuned(self) -> Case:
        """The controller that is tuned."""
        return self.trial.cases[0]

    @property
    def initial(self) -> dict[str, float]:
        """Initial values of the tuned numbers."""
        return {setting.name: float(getattr(self.tuned.controller, setting.name)) for setting in self.space}


def _bound(text: str, references: tuple[str, ...]) -> tuple[str, float | str]:
    name, _, most = (part.strip() for part in text.partition("="))
    if not most:
        raise Refusal(f"--at-most is {text!r}; write it like total-variation=500, or total-variation=mpc-se")
    if most in references:
        return name, most
    try:
        number = number_of(most)
    except ValueError:
        number = float("nan")
    if number != number:
        known = ", ".join(references) or "there is none"
        raise Refusal(
            f"--at-most is {text!r}; {most!r} is neither a number nor a controller that stands beside: {known}"
        )
    return name, number


ROBUST: Final = SearchStudy(
    name="robust",
    what="a search",
    help=(
        f"Search for a tuning of {SEARCHED} that is good for many people and for noise, and show the trade-off "
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
        "  glucoloop robust --sampler random --controller 'move_weight=.1:1, caution_weight=7.5' --out random\n\n"
        "  glucoloop run --noise 1.45 --config robust/best.toml"
    ),
    module="glucoloop.studies.robust.study",
    request=Search,
    option_texts={
        "help": {
            "controller": "Controller that is tuned, with ranges or kept numbers: "
            f"'{SEARCHED}, move_weight=.1:2, caution_weight=7.5'.",
            "duration_min": "Length of the run.",
            "meals": "Carbohydrate and time, like 50g@50min; repeat it for more meals.",
        },
        "panel": {"population": "People and noise"},
        "rare": dict.fromkeys(
            (
                *("people_seed", "first_seed", "check_people_seed", "check_first_seed", "batch"),
                *("prefer", "top", "announce_meals"),
            ),
            True,
        ),
    },
    results="candidates.parquet",
    files=("best.toml", "candidates.csv", "check.parquet", "front.pdf", "front.png", "front.svg"),
    summary="robust.json",
    extent=("rounds", "prefer", "top"),
)
