"""Measure controllers whose decisions have loops beside linear MPC: a day of a trial by native code, in turns.

    python benchmarks/loops.py [--people N] [--repeats N] [--precision float32|float64] [--controller TEXT ...]
                               [--patient NAME]

Three meals, 5-min samples, the default people of a patient, one thread. Times are of the processor, so that what else
runs on the machine disturbs less; the best of the repeats count. *Compiling* is lowering and LLVM together, without the
controller's design; *kernel* is the compiled loop alone, and *slower* is its time in that of the first controller.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from glucoloop.simulation.engines import NativeEngine
from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials.trial import Trial

CONTROLLERS = ("mpc", "nlqdmc-se", "meal-mpc")


@contextlib.contextmanager
def timed(of: Any, name: str) -> Iterator[list[float]]:
    """Processor seconds of each call of a method."""
    inner, seconds = getattr(of, name), list[float]()

    def outer(*given: Any, **options: Any) -> Any:
        start = time.process_time()
        result = inner(*given, **options)
        seconds.append(time.process_time() - start)
        return result

    setattr(of, name, outer)
    try:
        yield seconds
    finally:
        setattr(of, name, inner)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=1024)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--precision", choices=("float32", "float64"), default="float32")
    parser.add_argument("--controller", nargs="+", default=CONTROLLERS)
    parser.add_argument("--patient", default="parker-1999")
    asked = parser.parse_args()
    prepared, compiling = {}, {}
    for name in asked.controller:
        with timed(NativeEngine, "__init__") as seconds:
            keys = {"patient": asked.patient, "people": 1, "seed": 1, "precision": asked.precision}
            keys["controller"] = [name]
            prepared[name] = engine.prepare(configured(Trial, keys))
        compiling[name] = sum(seconds)
    trials: dict[str, list[float]] = {name: [] for name in prepared}
    kernels: dict[str, list[float]] = {name: [] for name in prepared}
    for _ in range(asked.repeats):
        for name, trial in prepared.items():
            kernel = trial.cases[name].loop.cohort._engine._kernel
            with timed(kernel, "run") as inside, timed(engine, "run_people") as whole:
                engine.run_people(trial, name, np.arange(asked.people), threads=1)
            trials[name].append(whole[0])
            kernels[name].append(sum(inside))
    print(f"{'':12}{'compiling, s':>14}{'trial, pd/s':>14}{'kernel, pd/s':>14}{'slower':>8}")
    first = min(kernels[asked.controller[0]])
    for name in prepared:
        best = min(kernels[name])
        rates = asked.people / min(trials[name]), asked.people / best
        print(f"{name:12}{compiling[name]:14.1f}{rates[0]:14.0f}{rates[1]:14.0f}{best / first:8.1f}")


if __name__ == "__main__":
    main()
