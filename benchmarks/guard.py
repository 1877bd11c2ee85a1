"""Measure what a guard costs a batch: the same people with it and without, in turns, on one core.

    python benchmarks/guard.py [--json] [--people N] [--repeats N]

A day with three meals, 5-min samples, `parker2000`; the whole path of a trial, from drawing people to their metrics.
Times are of the processor, so that what else runs on the machine disturbs less; the best of the repeats are compared.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from typing import Any

import numpy as np

from glucoloop.cohorts import engine
from glucoloop.config.trial import read_trial
from glucoloop.registry.guard import complete_guard

CONTROLLERS = ("mpc", "mpc-se", "imc")


def pair(controller: str, precision: str) -> engine.PreparedTrial:
    """A controller bare and guarded, in one trial."""
    base = read_trial({"people": 1, "seed": 1, "precision": precision, "controllers": [controller]})
    [case] = base.cases
    guarded = dataclasses.replace(case, label="guarded", guard=complete_guard({}))
    return engine.prepare(dataclasses.replace(base, cases=(dataclasses.replace(case, label="bare"), guarded)))


def measured(controller: str, precision: str, people: int, repeats: int) -> dict[str, Any]:
    """Patient-days a second of both, and the part of the speed that the guard costs."""
    prepared, times = pair(controller, precision), {"bare": list[float](), "guarded": list[float]()}
    for turn in range(repeats + 1):
        for label, taken in times.items():
            start = time.process_time()
            engine.run_people(prepared, label, np.arange(people), threads=1)
            if turn:  # the first one compiles
                taken.append(time.process_time() - start)
    speed = {label: people / min(taken) for label, taken in times.items()}
    return {
        "controller": controller,
        "precision": precision,
        **{f"{label}_patient_days_s": value for label, value in speed.items()},
        "cost_pct": 100.0 * (1.0 - speed["guarded"] / speed["bare"]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--people", type=int, default=4096)
    parser.add_argument("--repeats", type=int, default=15)
    asked = parser.parse_args()
    rows = [
        measured(controller, precision, asked.people, asked.repeats)
        for controller in CONTROLLERS
        for precision in ("float64", "float32")
    ]
    if asked.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'':22}{'bare':>12}{'guarded':>12}{'cost':>8}")
    for row in rows:
        speeds = f"{row['bare_patient_days_s']:12.0f}{row['guarded_patient_days_s']:12.0f}"
        print(f"{row['controller']:>8}, {row['precision']:12}{speeds}{row['cost_pct']:7.1f} %")


if __name__ == "__main__":
    main()
