"""Keys of a trial: people, meals, and the division of the work."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from glucoloop.config.key import Key, declared
from glucoloop.config.options.case import CONTROLLERS_TOLD, OF_OTHERS
from glucoloop.config.options.situation import SituationKeys
from glucoloop.control.catalogue import USUAL_CONTROLLER
from glucoloop.limits import LARGEST_COUNTER, LONGEST_RUN_MIN, MOST_DAYS, MOST_PEOPLE
from glucoloop.parts.patients import PATIENTS
from glucoloop.plausible import DURATION
from glucoloop.units import MIN_PER_DAY

PEOPLE_PANEL: Final = "People"
MEALS_PANEL: Final = "Meals"
CONTROLLERS_PANEL: Final = "Controllers"
WORK_PANEL: Final = "Work"
USUAL_DAY: Final = ("45g@7h", "70g@12h", "60g@18h")
"""Breakfast, lunch and dinner."""
SITUATION_KEYS: Final = tuple(
    key
    for key in declared(SituationKeys)
    if key not in ("initial_glucose_mg_dl", "meals", "duration_min", "integrator")
)
"""Keys that a trial has in common with a single run."""
_POPULATIONS: Final = "; ".join(
    f"of {entry.name}: " + "; ".join(f"{name}: {summary}" for name, summary in entry.populations.items())
    for entry in PATIENTS.values()
    if entry.populations
)
_people = functools.partial(Key, panel=PEOPLE_PANEL)
_meals = functools.partial(Key, panel=MEALS_PANEL)
_controllers = functools.partial(Key, panel=CONTROLLERS_PANEL)
_work = functools.partial(Key, panel=WORK_PANEL)


@dataclass(frozen=True, kw_only=True)
class TrialKeys:
    """Keys of a trial that a single run does not have."""

    people: Annotated[int, _people("Number of people.", at_least=1, at_most=MOST_PEOPLE)] = 1000
    population: Annotated[
        Any,
        _people(
            f"nominal; {_POPULATIONS}; or a table of your own in a file.",
            metavar="NAME|FILE.toml",
            told="the first of the patient's",
        ),
    ] = None
    first_person: Annotated[
        int,
        _people(
            "Number of the first person; a person of a given number and seed is always the same.",
            at_least=0,
            at_most=LARGEST_COUNTER,
        ),
    ] = 0
    days: Annotated[int | None, _meals("Days, each with the same meals.", told="1", at_least=1, at_most=MOST_DAYS)] = (
        None
    )
    duration_min: Annotated[
        float | None,
        _meals("Length of the run, in place of days.", above=0.0, at_most=LONGEST_RUN_MIN, quantity=DURATION),
    ] = None
    meals: Annotated[
        tuple[str, ...],
        _meals(
            "Carbohydrate and time of the day, like 45g@7h; repeat it for more meals.",
            flag="--meal",
            metavar="G@TIME",
            empty=("no_meal", "No meals."),
        ),
    ] = USUAL_DAY
    meal_size_spread_pct: Annotated[
        float,
        _meals("Largest deviation of a meal's size, drawn for each person and day.", at_least=0.0, below=100.0),
    ] = 0.0
    meal_time_spread_min: Annotated[
        float,
        _meals("Largest deviation of a meal's time, drawn for each person and day.", at_least=0.0, below=MIN_PER_DAY),
    ] = 0.0
    controllers: Annotated[
        tuple[str, ...],
        _controllers(
            f"{CONTROLLERS_TOLD}; {OF_OTHERS}. Repeat it for more.", flag="--controller", told=USUAL_CONTROLLER
        ),
    ] = ()
    design: Annotated[
        Literal["nominal", "individual"],
        _controllers("Whether controllers are designed once for the nominal patient, or for each person."),
    ] = "nominal"
    traces: Annotated[
        Any,
        _work(
            "People whose glucose and insulin over time are kept: none, all, or a number of people.",
            metavar="none|all|N",
        ),
    ] = "none"
    precision: Annotated[
        Literal["float32", "float64"],
        _work("Arithmetic of the loop; controllers are always designed in float64.", metavar="float32|float64"),
    ] = "float64"
    arithmetic: Annotated[
        Literal["fused", "portable"],
        _work(
            "Whether the loop may round a product together with its sum, which is faster, or rounds every operation by "
            "itself, so that any processor and a web page compute the same bits."
        ),
    ] = "fused"
    shard_people: Annotated[
        int | None,
        _work(
            "Number of people that are computed and written together.",
            told="up to 16384",
            at_least=1,
            at_most=1_000_000,
        ),
    ] = None
