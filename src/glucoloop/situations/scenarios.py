"""Scenarios: meals and exercise of the days, habits, announcement and length of a run together, by a name or in a file.

What a scenario has takes the place of defaults; what is given beside it counts. A scenario joins every command
that has meals by one class, entered in `SCENARIOS` or by the entry point of another package in the group
``glucoloop.scenarios``. A file has the same keys as a configuration.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Annotated, ClassVar, Final

from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import AHEAD, ANNOUNCEMENTS, EXERCISE, MEALS, TIME_OF_DAY
from glucoloop.component.grammar import NAME, Leaf, Tree, as_tree
from glucoloop.component.setting import PATIENT_PANEL, SENSOR_PANEL, Option
from glucoloop.control.action import ActionComponent
from glucoloop.faults import FaultComponent
from glucoloop.meals.habits import HabitComponent
from glucoloop.physiology.rhythm import RhythmComponent
from glucoloop.situations.therapy_settings import WrongProfile
from glucoloop.situations.toml import read_file
from glucoloop.unit_guess import DURATION
from glucoloop.units import LONGEST_AHEAD_MIN, LONGEST_RUN_MIN, MAX_DAYS, MIN_PER_DAY

DEFAULT_DAY: Final = ("45g@7h", "70g@12h", "60g@18h")
"""Breakfast, lunch and dinner."""
_CUSTOM: Final = "custom"
_patient = functools.partial(Option, panel=PATIENT_PANEL)

ANNOUNCED: Final = (MEALS, ANNOUNCEMENTS)
"""Needs of everything about announced meals."""
AnnounceMeals = Annotated[bool, _patient("Tell the controller of each meal when it begins.", needs=ANNOUNCED)]
AnnounceBefore = Annotated[
    float,
    _patient(
        "Time before eating at which meals are announced, of which controllers are told.",
        at_least=0.0,
        at_most=LONGEST_AHEAD_MIN,
        rare=True,
        needs=(*ANNOUNCED, AHEAD),
    ),
]
CarbError = Annotated[
    float,
    _patient(
        "Error of counting the carbohydrate of announced meals: its standard deviation in percent of a meal, drawn "
        "for each meal and person.",
        at_least=0.0,
        at_most=100.0,
        rare=True,
        needs=ANNOUNCED,
    ),
]
CarbBias = Annotated[
    float,
    _patient(
        "Mean of that error in percent of a meal; below 0 too little is announced.",
        at_least=-100.0,
        at_most=100.0,
        rare=True,
        needs=ANNOUNCED,
    ),
]
StartTime = Annotated[
    str | None,
    _patient(
        "Time of day at the start, of which controllers are told; not told by default.",
        metavar="HH:MM",
        rare=True,
        needs=(TIME_OF_DAY,),
    ),
]
Rhythms = Annotated[
    tuple[RhythmComponent, ...],
    _patient(
        "What follows the clock in the patient, like 'visentin-2015, pattern=hhl' or dawn; repeat it for more. The "
        "patient rests, and controllers are designed, as without it.",
        flag="--rhythm",
        rare=True,
    ),
]
Events = Annotated[
    tuple[FaultComponent, ...],
    Option(
        "Fault of sensor or pump that belongs to the day, inside of the others; repeat it for more.",
        flag="--event",
        panel=SENSOR_PANEL,
        rare=True,
    ),
]
Actions = Annotated[
    tuple[ActionComponent, ...],
    _patient(
        "What the person does by hand or tells the controller, like 'bolus, time=14h' or 'exercise, time=16h'; repeat "
        "it for more.",
        flag="--action",
        rare=True,
    ),
]
WarmUp = Annotated[
    float,
    Option(
        "Time before the start that is simulated and not counted; times of meals and faults count from the start.",
        at_least=0.0,
        at_most=LONGEST_RUN_MIN,
        rare=True,
    ),
]


class DaySettings(Component):
    """Meals, habits and exercise of the days, and their length: what a scenario and a situation both have."""

    days: Annotated[
        int | None, _patient("Days, each with the same meals.", default="1", at_least=1, at_most=MAX_DAYS, rare=True)
    ] = None
    duration_min: Annotated[
        float | None, Option("Length of the run.", above=0.0, at_most=LONGEST_RUN_MIN, quantity=DURATION)
    ] = None
    meals: Annotated[
        tuple[str, ...],
        _patient("Carbohydrate and time, like 50g@1.5h; repeat it for more.", flag="--meal", metavar="G@TIME"),
    ] = DEFAULT_DAY
    meal_size_spread_pct: Annotated[
        float,
        _patient(
            "Largest deviation of a meal's size, drawn for each person and day.",
            at_least=0.0,
            below=100.0,
            rare=True,
            needs=(MEALS,),
        ),
    ] = 0.0
    meal_time_spread_min: Annotated[
        float,
        _patient(
            "Largest deviation of a meal's time, drawn for each person and day.",
            at_least=0.0,
            below=MIN_PER_DAY,
            rare=True,
            needs=(MEALS,),
        ),
    ] = 0.0
    habits: Annotated[
        tuple[HabitComponent, ...],
        _patient(
            "Habit of the person, like 'unannounced, probability=0.2' or 'snack, time=21h', see glucoloop list; repeat "
            "it, each changes what the earlier ones leave.",
            flag="--habit",
            rare=True,
        ),
    ] = ()
    exercise: Annotated[
        tuple[str, ...],
        _patient(
            "Exercise: intensity in percent of the largest oxygen uptake above rest, time and duration, like "
            "50%@14h/30min; repeat it for more.",
            metavar="%@TIME/DURATION",
            rare=True,
        ),
    ] = ()
    exercise_spread_pct: Annotated[
        float,
        _patient(
            "Largest deviation of the intensity of exercise, drawn for each person and day.",
            at_least=0.0,
            below=100.0,
            rare=True,
            needs=(EXERCISE,),
        ),
    ] = 0.0
    exercise_time_spread_min: Annotated[
        float,
        _patient(
            "Largest deviation of its time, drawn for each person and day.",
            at_least=0.0,
            below=MIN_PER_DAY,
            rare=True,
            needs=(EXERCISE,),
        ),
    ] = 0.0


class ScenarioComponent(DaySettings):
    """Declaration of a scenario: the defaults of its settings."""

    kind: ClassVar = "scenario"

    announce_meals: AnnounceMeals = False
    announce_before_min: AnnounceBefore = 0.0
    carb_error_pct: CarbError = 0.0
    carb_bias_pct: CarbBias = 0.0
    profile_error: WrongProfile = None
    rhythm: Rhythms = ()
    actions: Actions = ()
    events: Events = ()
    start: StartTime = None
    warm_up_min: WarmUp = 0.0


class _Scenarios(Catalogue[ScenarioComponent]):
    """The scenarios; a text that ends in ``.toml`` is the path of a file."""

    def tree(self, text: str, source: str = "") -> Tree:
        """Tree of a scenario from its text, or from the file that it names."""
        if Path(text.strip()).suffix != ".toml":
            return super().tree(text, source)
        keys = as_tree(read_file(text.strip()).keys, text.strip())
        return {NAME: Leaf(_CUSTOM, source), **keys}


SCENARIOS: Final = _Scenarios(
    ScenarioComponent,
    {
        "plain-day": "glucoloop.situations.scenario_days:PlainDay",
        "unkind-day": "glucoloop.situations.scenario_days:UnkindDay",
        "week": "glucoloop.situations.scenario_days:Week",
        "year": "glucoloop.situations.scenario_days:Year",
        "occlusion": "glucoloop.situations.scenario_days:BlockedLine",
        "sensor-drift": "glucoloop.situations.scenario_days:DriftingSensor",
        "dropped-bolus": "glucoloop.situations.scenario_days:DroppedBolus",
        "exercise": "glucoloop.situations.scenario_days:ExerciseDay",
        "exercise-announced": "glucoloop.situations.scenario_days:AnnouncedExercise",
        "illness": "glucoloop.situations.scenario_days:Illness",
        "ratios-halved": "glucoloop.situations.scenario_days:RatiosHalved",
        "ratios-doubled": "glucoloop.situations.scenario_days:RatiosDoubled",
        "basal-halved": "glucoloop.situations.scenario_days:BasalHalved",
        "basal-doubled": "glucoloop.situations.scenario_days:BasalDoubled",
        "two-meals": "glucoloop.situations.scenario_days:TwoMeals",
        "slow-meal": "glucoloop.situations.scenario_days:SlowMeal",
        _CUSTOM: "glucoloop.situations.scenario_days:CustomScenario",
    },
    example="week, days=14",
)
