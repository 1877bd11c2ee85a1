"""Measure how fast people of each patient go through a day, in turns, on one core: most under linear MPC with noise.

    python benchmarks/families.py [--json] [--people N] [--repeats N] [--patient NAME ...]

A day with three meals, 5-min samples, the default population of each patient; the whole path of a trial, from drawing
people to their metrics. Those of parker-1999 are measured without noise too, and with noise and everybody's own meals.
The people of uva-padova-2008, each with an own gut that is an ODE, have boluses for announced meals and a monitor that
shows whole mg/dl. Times are of the processor, so that what else runs on the machine disturbs less; the best of the
repeats are compared, with the first patient as 1.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
from closed_loop import MEALS

from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials.trial import Trial

QUIET, OWN_MEALS = "parker-1999, no noise", "parker-1999, own meals"
PATIENTS = ("parker-1999", QUIET, OWN_MEALS, "hovorka-2004", "wilinska-2010", "uva-padova-2008")
KEYS = {
    "seed": 1,
    "sensor": ["white-noise, variance=1.45"],
    "meals": [f"{grams:g}g@{minutes:g}min" for grams, minutes in MEALS],
}
OTHERWISE = {
    QUIET: {"patient": "parker-1999", "sensor": ["ideal"]},
    OWN_MEALS: {"patient": "parker-1999", "meal_size_spread_pct": 30.0, "meal_time_spread_min": 45.0},
    "uva-padova-2008": {"controller": ["basal-bolus"], "announce_meals": True, "sensor": ["cgm-display"]},
}
"""What differs for a patient."""


def measured(patients: list[str], precision: str, people: int, repeats: int) -> list[dict[str, Any]]:
    """Patient-days a second of each patient, and how many times as fast it is as the first."""
    keys = {**KEYS, "people": people, "precision": precision, "controller": ["mpc"]}
    asked = {name: {**keys, "patient": name, **OTHERWISE.get(name, {})} for name in patients}
    trials = {name: engine.prepare(configured(Trial, of_patient)) for name, of_patient in asked.items()}
    taken: dict[str, list[float]] = {name: [] for name in patients}
    for turn in range(repeats + 1):
        for name, prepared in trials.items():
            start = time.process_time()
            engine.run_people(prepared, asked[name]["controller"][0], np.arange(people), threads=1)
            if turn:  # the first one compiles
                taken[name].append(time.process_time() - start)
    best = {name: min(times) for name, times in taken.items()}
    return [
        {
            "patient": name,
            "precision": precision,
            "patient_days_s": people / best[name],
            "times_as_fast": best[patients[0]] / best[name],
        }
        for name in patients
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--people", type=int, default=4096)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--patient", action="append", metavar="NAME", help="a patient; give it once for each")
    asked = parser.parse_args()
    patients = asked.patient or list(PATIENTS)
    rows = [
        row
        for precision in ("float64", "float32")
        for row in measured(patients, precision, asked.people, asked.repeats)
    ]
    if asked.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'':33}{'people/s':>12}{'times as fast':>16}")
    for row in rows:
        speed = f"{row['patient_days_s']:12.0f}{row['times_as_fast']:16.2f}"
        print(f"{row['patient']:>23}, {row['precision']:8}{speed}")


if __name__ == "__main__":
    main()
