#!/usr/bin/env python3
"""Measure how fast virtual people go through a day: three meals, 5-min samples, `parker2000`.

    python benchmarks/cohort.py [--quick] [--json] [--simglucose-python PYTHON] [--tables FILE]

Measured in one run: patient-days a second on one core and on all of them, of the loop alone and of the whole path of a
trial (drawing, basal rates, loop, metrics, histograms), in both precisions; beside it simglucose 0.2.11 and the
floating-point ceiling of the core; trials of one to a million people with their memory; and how accurate it is. The
repeats of everything go round in turns, so that a noisy machine is noisy for all. For simglucose see
``benchmarks/closed_loop.py``. ``--tables docs/speed_figures.md`` writes the tables of the documentation.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cohort_report
from closed_loop import simglucose

HERE = Path(__file__).resolve().parent
PRECISIONS = ("float64", "float32")
ROWS = (
    *(("plain", case) for case in ("basal", "mpc", "mpc-se", "nlqdmc-se")),
    ("noise", "mpc"),
    ("own meals", "mpc"),
    *(("noise and own meals", case) for case in ("mpc", "mpc-se")),
)
SIMULATED = "simglucose"
VERSIONS = {"JAX": "jax", "llvmlite": "llvmlite", "NumPy": "numpy"}
KERNELS = ("basal", "mpc", "mpc-se", "mpc, no metrics")


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def cores() -> list[int]:
    """The cores that this process may use."""
    known = getattr(os, "sched_getaffinity", None)
    return sorted(known(0)) if known else list(range(os.cpu_count() or 1))


@contextlib.contextmanager
def on_one_core() -> Iterator[None]:
    """What is started within stays on one core, where the system can be told so."""
    before = cores()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, before[-1:])
    try:
        yield
    finally:
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, before)


class Worker:
    """A process that measures what it is asked for; see `cohort_worker`."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(HERE / "cohort_worker.py")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __call__(self, what: str, **given: Any) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps({"do": what, **given}), file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        if not answer:
            sys.exit(f"the process that measures {what} ended; its message is above")
        return json.loads(answer)

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def speeds(one: Worker, every: Worker, repeats: int, python: str) -> dict[str, Any]:
    """Everything that is repeated, in turns: best and median of each."""
    plans = []
    for situation, case in ROWS:
        for precision in PRECISIONS:
            say(f"  making ready: {situation}, {case}, {precision}")
            how = one("about", situation=situation, precision=precision, case=case)
            every("about", situation=situation, precision=precision, case=case)
            if how["engine"] == "native" or precision == "float64":
                plans.append((situation, case, precision, how))
    result: dict[str, Any] = {}

    def keep(name: str, figures: dict[str, float]) -> None:
        for what, figure in figures.items():
            result.setdefault(name, {}).setdefault(what, []).append(figure)

    other: dict[str, Any] = {}
    for turn in range(-1, repeats):  # the first compiles, and does not count
        say(f"  turn {turn + 1} of {repeats}" if turn >= 0 else "  first turn, which compiles")
        for situation, case, precision, how in plans:
            slow = how["engine"] != "native"
            if slow and turn >= max(1, repeats // 3):
                continue
            for worker, name, threads in ((one, "one core", 1), (every, "all cores", 2 * len(cores()))):
                people = how["block"] * threads * (1 if slow else 2)
                given = {"situation": situation, "precision": precision, "case": case}
                figures = worker("speed", **given, people=people, threads=threads)
                if turn >= 0:
                    keep("|".join((situation, case, precision, name)), figures)
        for precision in PRECISIONS:
            for case in KERNELS:
                figures = one("kernel_speed", precision=precision, case=case, people=4096)
                if turn >= 0:
                    keep("|".join(("kernel", case, precision, "one core")), figures)
        if turn >= 0 and turn < max(1, repeats // 2) and "absent" not in other:
            say("  simglucose")
            with on_one_core():
                other = simglucose(python)
            if "absent" not in other:
                keep(SIMULATED, {"trial": 1.0 / other["day_s"]})
    best = {
        name: {what: {"best": max(of), "median": statistics.median(of)} for what, of in figures.items()}
        for name, figures in result.items()
    }
    engines = {f"{situation}|{case}": how["engine"] for situation, case, _, how in plans}
    return {"speeds": best, "engines": engines, SIMULATED: other}


def scaling(sizes: list[int]) -> list[dict[str, float]]:
    """Whole trials from the command line, from start to report page: time, and the most memory that each had."""
    made = []
    variables = {**os.environ, "PYTHONPATH": str(HERE.parent / "src")}
    with tempfile.TemporaryDirectory() as folder:
        for turn, people in enumerate([sizes[0], *sizes]):  # the first fills the cache of compiled code
            out = Path(folder) / str(turn)
            arguments = ["--people", str(people), "--controller", "mpc", "--precision", "float32", "--out", str(out)]
            start = time.perf_counter()
            with (Path(folder) / "said").open("w+") as said:
                process = subprocess.Popen(
                    [sys.executable, "-m", "glucoloop", "trial", *arguments, "--json"],
                    env=variables,
                    stdout=subprocess.DEVNULL,
                    stderr=said,
                )
                _, status, used = os.wait4(process.pid, 0)
                process.returncode = os.waitstatus_to_exitcode(status)
                said.seek(0)
                if process.returncode != 0:
                    sys.exit(f"a trial of {people} people failed:\n{said.read()}")
            seconds = time.perf_counter() - start
            unit = 1 if sys.platform == "darwin" else 1024
            size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
            if turn:
                say(f"  {people} people: {seconds:.1f} s")
                figures = {"people": people, "seconds": seconds}
                made.append({**figures, "memory_MB": used.ru_maxrss * unit / 1e6, "disk_MB": size / 1e6})
    return made


def measure(quick: bool, python: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as cache:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = cache
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.2"
        say("starting a process on one core, and one on all")
        with on_one_core():
            one = Worker()
        every = Worker()
        results: dict[str, Any] = {"cores": len(cores()), "quick": quick}
        results |= speeds(one, every, 2 if quick else 5, python)
        say("the ceiling of a core")
        results["ceilings"] = {p: one("kernels", precision=p, repeats=5 if quick else 25) for p in PRECISIONS}
        say("where the time goes")
        results["parts"] = {
            f"{situation}|{precision}": min(
                (one("parts", situation=situation, precision=precision, people=4096) for _ in range(2 if quick else 4)),
                key=lambda parts: sum(parts.values()),
            )
            for situation in ("plain", "noise", "own meals", "noise and own meals")
            for precision in PRECISIONS
        }
        say("accuracy")
        results["accuracy"] = every("accuracy", people=20 if quick else 200, tolerance=1e-10)
        results["precisions"] = every("single_against_double", people=2048 if quick else 16384)
        for worker in (one, every):
            worker.close()
        del os.environ["JAX_COMPILATION_CACHE_DIR"], os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"]
    say("trials of growing size")
    results["scaling"] = scaling([1, 100, 10_000] if quick else [1, 10, 100, 1000, 10_000, 100_000, 1_000_000])
    return results


def circumstances() -> dict[str, str]:
    """Where and with what it was measured."""
    versions = ", ".join(f"{name} {importlib.metadata.version(of)}" for name, of in VERSIONS.items())
    return {
        "date": time.strftime("%Y-%m-%d"),
        "machine": f"{len(cores())} cores of {_processor()}",
        "versions": f"Python {platform.python_version()}, {versions}",
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--quick", action="store_true", help="fewer repeats and people, some minutes in all")
    parser.add_argument("--simglucose-python", default=sys.executable, help="interpreter that can import simglucose")
    parser.add_argument("--machine", help="what to call the machine")
    parser.add_argument("--tables", type=Path, metavar="FILE", help="write the tables of the documentation too")
    parser.add_argument("--read", type=Path, metavar="FILE", help="measure nothing; show what --json printed")
    options = parser.parse_args()
    if options.read is None:
        results = {**circumstances(), **measure(options.quick, options.simglucose_python)}
    else:
        results = json.loads(options.read.read_text(encoding="utf-8"))
    if options.machine is not None:
        results["machine"] = options.machine
    if options.tables is not None:
        options.tables.write_text(cohort_report.tables(results), encoding="utf-8")
    print(json.dumps(results, indent=2) if options.json else cohort_report.report(results))


if __name__ == "__main__":
    main()
