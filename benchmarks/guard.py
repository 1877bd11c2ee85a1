"""Measure what a guard costs a batch: the same people with it and without, in turns, on one core.

    python benchmarks/guard.py [--json] [--people N] [--repeats N]

A day with three meals, 5-min samples, `parker2000`; the whole path of a trial, from drawing people to their metrics.
Times are of the processor, so that what else runs on the machine disturbs less; the best of the repeats are compared.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from pairs import answer

from glucoloop.native.targets.llvm import kernel
from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials.trial import Trial

CONTROLLERS = ("mpc", "imc", "mpc-se", "nlqdmc-se", "meal-mpc")


def pair(controller: str, precision: str) -> engine.PreparedTrial:
    """A controller bare and guarded, in one trial."""
    cases = [f"{controller}, label=bare", f"{controller}, label=guarded, guard=usual"]
    return engine.prepare(configured(Trial, people=1, seed=1, precision=precision, controller=cases))


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


if __name__ == "__main__":
    kernel.MANY_ROUNDS = 0  # code for speed, as of large populations
    answer(__doc__, measured, CONTROLLERS, ("bare", "guarded"), people=4096)
