"""The options of a trial."""

from __future__ import annotations

from typing import Final

from glucoloop.cli.options import CASE, MEALS, MMOL, OUTPUT, SITUATION, Option, reworded
from glucoloop.registry.patients import PATIENTS

_PEOPLE: Final = "People"
_MEALS: Final = "Meals"
_CONTROLLERS: Final = "Controllers"
_WORK: Final = "Work"
_NOT_OF_A_TRIAL: Final = ("initial_glucose_mg_dl", MEALS, "duration_min", "integrator", "controller", "model")

CASES: Final = Option(
    "cases",
    "--case",
    list[str],
    "A controller with settings of its own, like 'careful: mpc, move_weight=1'; repeat it for more.",
    _CONTROLLERS,
    metavar="CASE",
)
CONTROLLERS: Final = Option(
    "controllers",
    "--controller",
    list[str],
    next(option.help for option in CASE if option.key == "controller") + " Repeat it for more.",
    _CONTROLLERS,
    metavar="NAME",
    default="mpc",
)
GUARDS: Final = Option(
    "guards",
    "--guards",
    str,
    "Whether controllers are tried with a guard, without one, or both.",
    "Guard",
    metavar="both|with|without",
    default="both",
)
WORKERS: Final = Option(
    "workers",
    "--workers",
    int,
    "Threads that compute; with --dask local, processes.",
    _WORK,
    metavar="N",
    default="one a core",
)
DASK: Final = Option(
    "dask",
    "--dask",
    str,
    "Compute on a Dask cluster: the address of its scheduler, like tcp://10.0.0.1:8786, or local.",
    _WORK,
    metavar="ADDRESS",
)
TRIAL: Final = (
    Option("people", "--people", int, "How many.", _PEOPLE, metavar="N", default="1000"),
    Option(
        "population",
        "--population",
        str,
        "nominal; "
        + "; ".join(
            f"of {entry.name}: " + "; ".join(f"{name}: {summary}" for name, summary in entry.populations.items())
            for entry in PATIENTS.values()
            if entry.populations
        )
        + "; or a table of your own in a file.",
        _PEOPLE,
        metavar="NAME|FILE.toml",
        default="the first of the patient's",
    ),
    Option(
        "first_person",
        "--first-person",
        int,
        "Number of the first person; a person of a given number and seed is always the same.",
        _PEOPLE,
        metavar="N",
        default="0",
    ),
    Option("days", "--days", int, "Days, each with the same meals.", _MEALS, metavar="N", default="1"),
    Option("duration_min", "--duration", float, "Length of the run, in place of days.", _MEALS, metavar="MIN"),
    Option(
        MEALS,
        "--meal",
        list[str],
        "Carbohydrate and time of the day, like 45g@7h; repeat it for more meals.",
        _MEALS,
        metavar="G@TIME",
        default="45g@7h, 70g@12h, 60g@18h",
    ),
    Option("no_meal", "--no-meal", bool, "Nothing is eaten.", _MEALS),
    Option(
        "meal_size_spread_pct",
        "--meal-size-spread",
        float,
        "Largest deviation of a meal's size, drawn for each person and day.",
        _MEALS,
        metavar="PCT",
        default="0",
    ),
    Option(
        "meal_time_spread_min",
        "--meal-time-spread",
        float,
        "Largest deviation of a meal's time, drawn for each person and day.",
        _MEALS,
        metavar="MIN",
        default="0",
    ),
    CONTROLLERS,
    CASES,
    Option(
        "design",
        "--design",
        str,
        "Whether controllers are designed once for the nominal patient, or for each person.",
        _CONTROLLERS,
        metavar="nominal|individual",
        default="nominal",
    ),
    *reworded(
        (option for option in (*SITUATION, *CASE) if option.key not in _NOT_OF_A_TRIAL),
        help={
            "operating_point": "Operating point of the nominal patient, for whom controllers are designed.",
            "setpoint_mg_dl": "Glucose at which all people rest at the start, and the target; that of the operating "
            "point by default.",
            "seed": "The same seed gives the same people, meals and noise.",
        },
        panel={
            **dict.fromkeys(("patient", "setpoint_mg_dl", "seed", "operating_point"), _PEOPLE),
            **dict.fromkeys(("announce_meals", "carb_error_pct", "carb_bias_pct", "start"), _MEALS),
        },
    ),
    Option(
        "traces",
        "--traces",
        str,
        "People whose glucose and insulin over time are kept: none, all, or a number of people.",
        _WORK,
        metavar="none|all|N",
        default="none",
    ),
    Option(
        "precision",
        "--precision",
        str,
        "Precision of the loop; controllers are always designed in float64.",
        _WORK,
        metavar="float32|float64",
        default="float64",
    ),
    Option(
        "arithmetic",
        "--arithmetic",
        str,
        "Whether the loop may round a product together with its sum, which is faster, or rounds every operation by "
        "itself, so that any processor and a web page compute the same bits.",
        _WORK,
        metavar="fused|portable",
        default="fused",
    ),
    Option(
        "shard_people",
        "--shard-people",
        int,
        "Number of people that are computed and written together.",
        _WORK,
        metavar="N",
        default="up to 16384",
    ),
    WORKERS,
    DASK,
    *reworded(
        (*OUTPUT, MMOL),
        help={
            "out": "Folder of the trial; an unfinished trial in it is resumed.",
            "overwrite": "Begin again and replace the trial in the folder.",
            "json": "Print the summary as one JSON object.",
        },
    ),
)
