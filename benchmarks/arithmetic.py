"""Measure what portable arithmetic costs a trial: the same people with fused and with portable arithmetic, in turns.

    python benchmarks/arithmetic.py [--json] [--people N] [--repeats N]

A day with three meals, 5-min samples, `parker2000`, on one core; the compiled loop alone, from the people's numbers to
their metrics. Times are of the processor, so that what else runs on the machine disturbs less; the best of the repeats
are compared. Beside them, the largest difference that the arithmetic makes to glucose.
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

CONTROLLERS = ("mpc", "mpc-se", "imc")


def measured(controller: str, precision: str, people: int, repeats: int) -> dict[str, Any]:
    """Patient-days a second of both kinds of arithmetic, the cost, and the difference of glucose."""
    loops, glucose = {}, {}
    for kind in ("fused", "portable"):
        keys = {"people": 1, "seed": 1, "precision": precision, "controller": [controller], "arithmetic": kind}
        prepared = engine.prepare(configured(Trial, keys))
        [case] = prepared.cases.values()
        trial, block = prepared.trial, np.arange(people)
        drawn = case.loop.people(engine.people_of(trial, block), **engine.brought(trial, trial.drawn_days(block)))
        glucose[kind] = case.loop.cohort.run(drawn).glucose_mg_dl  # which also compiles
        loops[kind] = (case.loop.cohort, drawn)
    times: dict[str, list[float]] = {kind: [] for kind in loops}
    for _ in range(repeats):
        for kind, (cohort, drawn) in loops.items():
            start = time.process_time()
            cohort.run(drawn)
            times[kind].append(time.process_time() - start)
    best = {kind: min(taken) for kind, taken in times.items()}
    return {
        "controller": controller,
        "precision": precision,
        **{f"{kind}_patient_days_s": people / seconds for kind, seconds in best.items()},
        "cost_pct": 100.0 * (1.0 - best["fused"] / best["portable"]),
        "difference_mg_dl": float(np.nanmax(np.abs(glucose["fused"] - glucose["portable"]))),
    }


if __name__ == "__main__":
    kernel.MANY_ROUNDS = 0  # code for speed, as of large populations
    answer(
        __doc__,
        measured,
        CONTROLLERS,
        ("fused", "portable"),
        people=1024,
        head=f"{'difference, mg/dl':>20}",
        more=lambda row: f"{row['difference_mg_dl']:20.1e}",
    )
