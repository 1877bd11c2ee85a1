"""Measure controllers whose decisions have loops beside linear MPC: a day of a trial by native code, in turns.

    python benchmarks/loops.py [--people N] [--repeats N] [--precision float32|float64] [--controller TEXT ...]
                               [--patient NAME]

Three meals, 5-min samples, the default people of a patient, one thread, nothing kept. Times are of the processor, so
that what else runs on the machine disturbs less; the best of the repeats count. *Lowering* is without the controller's
design; LLVM compiles the loop *quickly*, and *for speed* where so many people take it that this pays; *kernel* is the
compiled loop alone, in patient-days a second, and *slower* the time of the better one in that of the first controller.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from glucoloop._disk_cache import VARIABLE
from glucoloop.native.targets.llvm import kernel as llvm
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
    os.environ[VARIABLE] = "off"
    prepared, rows = {}, {}
    for name in asked.controller:
        keys = {"patient": asked.patient, "people": 1, "seed": 1, "precision": asked.precision, "controller": [name]}
        with timed(NativeEngine, "__init__") as lowering:
            prepared[name] = engine.prepare(configured(Trial, keys))
        rows[name] = [sum(lowering)]
    for rounds in (math.inf, 0):  # what is compiled quickly, and for speed
        llvm.MANY_ROUNDS = rounds
        trials: dict[str, list[float]] = {name: [] for name in prepared}
        kernels: dict[str, list[float]] = {name: [] for name in prepared}
        for name, trial in prepared.items():
            with timed(llvm.Kernel, "_compile") as compiling:
                engine.run_people(trial, name, np.arange(1), threads=1)
            rows[name].append(sum(compiling))
        for _ in range(asked.repeats):
            for name, trial in prepared.items():
                kernel = trial.cases[name].loop.cohort._engine._kernel
                with timed(kernel, "run") as inside, timed(engine, "run_people") as whole:
                    engine.run_people(trial, name, np.arange(asked.people), threads=1)
                trials[name].append(whole[0])
                kernels[name].append(sum(inside))
        for name in prepared:
            rows[name].append(asked.people / min(kernels[name]))
    headings = ("lowering, s", "quickly, s", "kernel, pd/s", "for speed, s", "kernel, pd/s", "slower", "trial, pd/s")
    print(f"{'':12}" + "".join(f"{heading:>14}" for heading in headings))
    for name, (lowering_s, quickly_s, quick, for_speed_s, best) in rows.items():
        slower, trial = rows[asked.controller[0]][-1] / best, asked.people / min(trials[name])
        print(
            f"{name:12}{lowering_s:14.1f}{quickly_s:14.2f}{quick:14.0f}{for_speed_s:14.2f}{best:14.0f}"
            f"{slower:14.1f}{trial:14.0f}"
        )


if __name__ == "__main__":
    main()
