"""Measure what controllers reach with subcutaneous insulin, on people whose profiles are titrated and 15 % wrong.

    python benchmarks/subcutaneous.py [--json] [--people N] [--seed N] [--case NAME ...] [--controller TEXT ...]
                                        [--announce-before MIN] [--days N]

Days of 45, 70 and 60 g, the sizes of which spread by 30 % and the times by 30 min. Announced meals are counted with an
error of 30 %. Readings have white noise of variance 1.45 (white), or lag by 10 min and have a correlated error with a
standard deviation of 9 mg/dl (cgm). Ratio and factor of each person's profile are titrated on the person and then
multiplied by lognormal errors with a standard deviation of 15 %. A case lasts for three days, or seven where the
profile is as wrong on each of them as it says: ratio and factor halved, or the basal rate doubled.

The settings of profile-mpc were chosen on people of seeds 1 and 2, those of therapy-mpc on people of seed 301. No
setting has seen those of seeds 4, 51, 81 and from 90000 on.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np

from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import surroundings_of
from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials.trial import Trial
from glucoloop.units import MIN_PER_DAY

PROFILE_ERROR = "spread_pct=15"
PATIENTS = {
    "hovorka": {"patient": "hovorka-2004", "population": "boiroux2017"},
    "wilinska": {"patient": "wilinska-2010", "population": "wilinska2010"},
    "uva-padova": {"patient": "uva-padova-2008", "population": "lognormal"},
    "mvp": {"patient": "kanderian-2009", "population": "kanderian2009"},
}
SENSORS = {
    "white": ["white-noise, variance=1.45"],
    "cgm": ["lag, lag_min=10", "correlated-noise, variance=81, correlation=0.7"],
}
TUNED = {"white": ", sensor_lag_min=0, sensor_error_mg_dl=0", "cgm": ""}
"""Settings by which a controller expects the sensor; by default it expects a monitor."""
EXPECTING_A_MONITOR = ("therapy-mpc", "profile-mpc")
DAYS = {"announced": 3, "unannounced": 3, "a week": 7, "ratios halved": 7, "basal doubled": 7}
WRONG = {"ratios halved": ", ratio_pct=50", "basal doubled": ", basal_pct=200"}
CASES = [
    f"{patient}, {what}, {sensor}"
    for patient in PATIENTS
    for what in DAYS
    for sensor in SENSORS
    if sensor == "cgm" or DAYS[what] == 3
]
MOST = {"mvp": 10}
"""People whom a population has."""
REPORTED = ("time_70_180_pct", "time_below_70_pct", "time_below_54_pct")
BY_DAY = ("first_day_below_54_pct", "last_day_below_54_pct", "last_day_70_180_pct")


def trial_of(case: str, people: int, seed: int, controller: str, **more: Any) -> Trial:
    """Trial of a case."""
    patient, what, sensor = case.split(", ")
    announced = what != "unannounced"
    return configured(
        Trial,
        {
            **PATIENTS[patient],
            "people": min(people, MOST.get(patient, people)),
            "seed": seed,
            "days": DAYS[what],
            "meals": ["45g@7h", "70g@12h", "60g@18h"],
            "meal_size_spread_pct": 30.0,
            "meal_time_spread_min": 30.0,
            "announce_meals": announced,
            **({"carb_error_pct": 30.0} if announced else {}),
            "sensor": SENSORS[sensor],
            "profile_by": "titration",
            "profile_error": PROFILE_ERROR + WRONG.get(what, ""),
            "controller": [controller],
            **more,
        },
    )


def measured(case: str, people: int, seeds: list[int], text: str, **more: Any) -> list[dict[str, Any]]:
    """Figures of a controller in a case for people of each seed; the loop is compiled once."""
    trial = trial_of(case, people, seeds[0], text, **more)
    [asked] = trial.cases
    accumulator, controller, rows = engine.fold_of(trial), controller_of(trial, asked), []
    loop = engine.loop_of(trial, controller, accumulator)
    of_case = engine.PreparedCase(controller, loop, surroundings_of(trial), ())
    for seed in seeds:
        prepared = engine.PreparedTrial(trial_of(case, people, seed, text, **more), accumulator, {asked.label: of_case})
        start = time.perf_counter()
        result = engine.run_people(prepared, asked.label, np.arange(prepared.trial.people), traces=True)
        taken = time.perf_counter() - start
        metrics = {name: values[result.feasible] for name, values in result.metrics.items()}
        a_day, glucose = round(MIN_PER_DAY / trial.sample_time_min), result.glucose_mg_dl[:, result.feasible]
        first, last = glucose[: a_day + 1], glucose[-a_day - 1 :]
        by_day = ((first < 54.0).any(axis=0), (last < 54.0).any(axis=0), (last >= 70.0) & (last <= 180.0))
        rows.append(
            {
                "case": case,
                "controller": text,
                "seed": seed,
                "people": int(result.feasible.sum()),
                **{name: float(np.mean(metrics[name])) for name in REPORTED},
                "ever_below_54_pct": 100.0 * float(np.mean(metrics["time_below_54_pct"] > 0.0)),
                **{name: 100.0 * float(np.mean(values)) for name, values in zip(BY_DAY, by_day, strict=True)},
                "below_54_pct": metrics["time_below_54_pct"],
                "engine": loop.engine,
                "patient_days_s": prepared.trial.people * prepared.trial.days / taken,
            }
        )
    return rows


def compared(result: list[list[dict[str, Any]]]) -> None:
    """Add the share of people who are below 54 mg/dl for longer than under the last controller."""
    for rows in result:
        for row, last in zip(rows, result[-1], strict=True):
            row["longer_below_54_pct"] = 100.0 * float(np.mean(row["below_54_pct"] > last["below_54_pct"]))
    for row in (row for rows in result for row in rows):
        del row["below_54_pct"]


def line(row: dict[str, Any]) -> str:
    """Line of the table."""
    shown = [f"{row[name]:.1f}" for name in (*REPORTED, "ever_below_54_pct", *BY_DAY, "longer_below_54_pct")]
    named = [row["case"], row["controller"].partition(",")[0], row["seed"], row["people"], *shown]
    return "| " + " | ".join(map(str, named)) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--people", type=int, default=300)
    parser.add_argument("--seed", type=int, action="append", help="a seed; give it once for each; by default 1 and 4")
    parser.add_argument("--case", action="append", metavar="NAME", help="a case, or the beginning of its name")
    parser.add_argument(
        "--controller", action="append", metavar="TEXT", help="by default therapy-mpc, profile-mpc and basal-bolus"
    )
    parser.add_argument(
        "--announce-before", type=float, default=0.0, metavar="MIN", help="announce meals so long before eating"
    )
    parser.add_argument("--days", type=int, help="by default those of the case; fewer are the first of them")
    asked = parser.parse_args()
    if not asked.json:
        headings = ["70-180", "< 70", "< 54", "ever < 54", "first day < 54", "last day < 54", "last day 70-180"]
        print(f"| case | controller | seed | people | {', % | '.join(headings)}, % | longer < 54, % |")
        print("| :--- | :--- |" + 10 * " ---: |")
    rows: list[dict[str, Any]] = []
    for case in CASES:
        if not any(case.startswith(wanted) for wanted in asked.case or [""]):
            continue
        of_sensor = TUNED[case.split(", ")[2]]
        controllers = asked.controller or [*(name + of_sensor for name in EXPECTING_A_MONITOR), "basal-bolus"]
        more: dict[str, Any] = {} if asked.days is None else {"days": asked.days}
        if ", unannounced" not in case:
            more["announce_before_min"] = asked.announce_before
        result = [measured(case, asked.people, asked.seed or [1, 4], text, **more) for text in controllers]
        compared(result)
        rows += [row for of_controller in result for row in of_controller]
        if not asked.json:
            print("\n".join(map(line, rows[-sum(map(len, result)) :])), flush=True)
    if asked.json:
        print(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
