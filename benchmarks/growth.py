#!/usr/bin/env python3
"""Measure how time and memory of a trial grow: with people, days, cores and Dask workers; beside simglucose.

    python benchmarks/growth.py [--small] [--lines N ...] [--simglucose-python PYTHON]

Each line is a ``glucoloop trial`` of ``parker2000`` under linear MPC in float32 in a process of its own, from start to
report page, with everything compiled before: wall time, time of all processors, the most memory that one process had,
and patient-days in a second of a processor. Cores are those that the process may use, which Linux alone can limit. A
person-day of simglucose, in the same run, by its processor time too, gives the last column; for its interpreter see
``benchmarks/closed_loop.py``. ``--small`` leaves out what has more than 3000 patient-days; ``--lines`` measures the
lines of these numbers alone, counted from 1.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

from closed_loop import simglucose
from long_runs import of_process

PEOPLE, DAYS = (1, 1_000, 100_000), (1, 10, 100, 366)
LINES = (
    *((people, 1, 2, 0) for people in PEOPLE),
    *((1, days, 2, 0) for days in DAYS[1:]),
    *((1_000, days, 2, 0) for days in DAYS[1:]),
    (100_000, 1, 1, 0),
    (100_000, 1, 2, 1),
    (100_000, 1, 2, 2),
)
"""People, days, cores and Dask workers, of which 0 are threads of the one process."""
SMALL = 3_000


def measured(people: int, days: int, cores: int, workers: int) -> dict[str, float]:
    """Wall time [s], processor time [s] and memory [MiB] of one trial."""
    dask = ("--dask", "local", "--workers", str(workers)) if workers else ()
    allowed = os.sched_getaffinity(0)
    with tempfile.TemporaryDirectory(prefix="glucoloop-growth-") as place:
        out, scenario = str(Path(place) / "out"), f"week, days={days}"
        length = ("--people", str(people), "--scenario", scenario, "--precision", "float32", "--controller", "mpc")
        os.sched_setaffinity(0, sorted(allowed)[:cores])  # which the process inherits
        started = time.perf_counter()
        try:
            spent = of_process("trial", *length, *dask, "--out", out, days=days)
        finally:
            os.sched_setaffinity(0, allowed)
        return {**spent, "wall_s": time.perf_counter() - started}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help=f"only up to {SMALL} patient-days")
    parser.add_argument("--lines", type=int, nargs="+", default=range(1, len(LINES) + 1), help="numbers of lines")
    parser.add_argument("--simglucose-python", default=sys.executable, help="interpreter that can import simglucose")
    asked = parser.parse_args()
    other = simglucose(asked.simglucose_python)
    known = "absent" not in other
    said = f"{other['day_processor_s']:.1f} s of a processor for a patient-day" if known else other["absent"]
    print(f"simglucose: {said}", flush=True)
    print(f"load {os.getloadavg()[0]:.1f}\n\n| People | Days | Cores | Dask workers | Wall, s | Processors, s ", end="")
    print("| Memory, MiB | Patient-days a processor second | Beside simglucose |\n|" + " ---: |" * 9, flush=True)
    for turn, (people, days, cores, workers) in enumerate([LINES[0], *LINES]):  # the first compiles
        if turn and (turn not in asked.lines or (asked.small and people * days > SMALL)):
            continue
        spent = measured(people, days, cores, workers)
        rate = people * days / spent["seconds"]
        beside = f"{rate * other['day_processor_s']:.3g}" if known else ""
        cells = (
            f"{spent['wall_s']:.1f}",
            f"{spent['seconds']:.1f}",
            f"{spent['memory_MiB']:.0f}",
            f"{rate:.3g}",
            beside,
        )
        if turn:
            print(f"| {people} | {days} | {cores} | {workers or '-'} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
