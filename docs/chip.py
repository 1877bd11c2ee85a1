"""Compare exported controllers with themselves on emulated chips, prove their bounds, and write the tables of a page.

    python docs/chip.py                                      every controller, up to 10 000 samples in every cell
    python docs/chip.py --samples 1000 --controller mpc-se   a part of it
    python docs/chip.py --proofs                             MISRA C:2012, and bounds by Frama-C
    python docs/chip.py --tables                             the tables alone

A cell is a controller, bare, guarded, or guarded by forecast where it gives boluses, in float32 or float64, on this
computer or on an emulated chip. Its samples
come in runs of 100: each is a closed loop with meals and faults of its own, whose last sixth is told absurd numbers.
Controllers that give boluses have a patient with subcutaneous insulin, and are told of the meals.
What was found is kept in ``chip_results.json`` after every step, and a later call goes on from there; what was found of
a controller counts only as long as its design gives the same C. ``guide/chip_figures.md`` is written from it. Quick
cells come first. The compilers, QEMU, cppcheck and Frama-C that ``guide/chip.md`` names are needed.
"""

import argparse
import dataclasses
import functools
import json
import resource
import sys
import time
from pathlib import Path

import jax

from glucoloop.cli.jax_cache import keep_compiled
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.firmware.checks import (
    bounds_proved,
    change_proved,
    emulated,
    interpreted,
    misra,
    native,
    on_this_computer,
)
from glucoloop.firmware.chips import CHIPS
from glucoloop.firmware.exported import PRECISIONS
from glucoloop.firmware.samples import joined
from glucoloop.situations.situation import configured
from glucoloop.studies.export import Export
from glucoloop.studies.export.study import Made

FOLDER = Path(__file__).resolve().parent
RESULTS, FIGURES = FOLDER / "chip_results.json", FOLDER / "guide" / "chip_figures.md"
HERE = "computer"
RUN, MAX_RUNS = 100, 50
"""Samples of a run, and the largest number of runs in one program."""
IN_NUMPY, IN_NUMPY_SLOW = 10, 1
"""Samples of each run that are computed operation by operation."""
LEVELS = (RUN, 1000)
"""Numbers of samples that every slow cell reaches before any goes on."""
A_PROGRAM = 4e9
"""Instructions that an emulated program may take: a minute, so that a busy machine does not exceed the longest time of
a program, and not much is lost when the command is stopped."""
TOLD = {"patient": "hovorka-2004", "announce_meals": True}
"""Situation of the controllers that give boluses."""
GUARDS = {"bare": None, "guarded": "usual", "forecast": "forecast"}
"""Guards by the word of the tables; that by forecast is of the controllers that give boluses."""
SLOW, FORECAST, SOFT = 3e6, 2e5, {"cortex-m4f": 30.0, "rv32": 80.0}
"""Guesses: instructions of a step of a slow controller and of the guard by forecast, and what float64 costs where the
chip has only float32."""


@dataclasses.dataclass(frozen=True)
class Case:
    """An exported controller."""

    controller: str
    guard: str
    precision: str

    @property
    def name(self):
        return f"{self.controller} {self.guard} {self.precision}"

    @functools.cached_property
    def made(self):
        told = TOLD if CONTROLLERS[self.controller].gives_boluses else {}
        return Made(
            configured(Export, controller=[self.controller], guard=GUARDS[self.guard], precision=self.precision, **told)
        )

    def guess(self, chip):
        """Instructions of a step, roughly."""
        soft = SOFT.get(chip, 1.0) if self.precision == "float64" else 1.0
        return (SLOW if self.slow else FORECAST if self.guard == "forecast" else 5e3) * soft

    @property
    def slow(self):
        return CONTROLLERS[self.controller].slow


def kept(case):
    """What was found of the C that a case gives now."""
    source = case.made.exported.source
    result = everything().get(case.name, {})
    if result.get("design") == source.design[:16]:
        return result
    return {"design": source.design[:16], "form": source.form, "cells": {}, "proofs": {}}


def keep(case, part, name, result):
    """Write what was found; another process may have written something else since this one read the file."""
    everything_now = everything() | {case.name: kept(case)}
    everything_now[case.name][part][name] = result
    ordered = {case.name: everything_now[case.name] for case in cases(CONTROLLERS) if case.name in everything_now}
    RESULTS.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
    write_tables()


def everything():
    return json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.is_file() else {}


@functools.lru_cache(maxsize=2 * MAX_RUNS)
def run_of(case, seed):
    return case.made.recorded(RUN, seed)


def cases(controllers):
    ordered = sorted(controllers, key=lambda name: CONTROLLERS[name].slow)
    return [
        Case(name, guard, precision)
        for precision in PRECISIONS
        for name in ordered
        for guard in GUARDS
        if guard != "forecast" or CONTROLLERS[name].gives_boluses
    ]


def compare(cases, samples):
    """Bring every cell to so many samples, slow ones last and by turns."""
    cells = [(case, chip) for case in cases for chip in (HERE, *CHIPS)]
    slow = [(case, chip) for case, chip in cells if case.guess(chip) > 2 * SLOW]
    slow.sort(key=lambda cell: cell[0].guess(cell[1]))
    go_on([cell for cell in cells if cell not in slow], samples)
    for level in sorted({min(level, samples) for level in (*LEVELS, samples)}):
        go_on(slow, level)


def go_on(cells, samples):
    for case, chip in cells:
        cell = kept(case)["cells"].get(chip, {"samples": 0})
        while cell["samples"] < samples:
            start, done = time.perf_counter(), cell["samples"] // RUN
            at_once = int(A_PROGRAM / (RUN * cell.get("instructions", case.guess(chip))))
            runs = max(1, min(at_once, MAX_RUNS, -(-samples // RUN) - done))
            record = joined([run_of(case, seed) for seed in range(done, done + runs)])
            result = other_ways(case, record) if chip == HERE else on_chip(case, record, CHIPS[chip])
            for key, value in result.items():
                before = cell.get(key, 0)
                cell[key] = before + value if key.startswith("samples") else max(before, value)
            keep(case, "cells", chip, cell)
            took = time.perf_counter() - start
            print(f"{case.name}, {chip}: {cell['samples']} samples, the last {runs * RUN} in {took:.0f} s", flush=True)


def other_ways(case, record):
    """Numbers of samples that were computed in other ways than where they were recorded."""
    exported, runs = case.made.exported, len(record.observations) // record.run
    checked = runs * (IN_NUMPY_SLOW if case.slow else IN_NUMPY)
    checks = {"samples": on_this_computer(exported, record), "samples_numpy": interpreted(exported, record, checked)}
    if exported.source.lowered is not None:
        checks["samples_llvm"] = native(exported, record)
    return {key: told(case, check).measured["samples"] for key, check in checks.items()}


def on_chip(case, record, chip):
    return told(case, emulated(case.made.exported, record, chip)).measured


def prove(cases):
    """The proofs and MISRA C:2012, of what has none yet."""
    for name, check_of in (("bounds", bounds_proved), ("change", change_proved), ("rules", misra)):
        for case in cases:
            if name in kept(case)["proofs"]:
                continue
            exported, start = case.made.exported, computed_s()
            check = check_of(exported)
            took = computed_s() - start
            keep(case, "proofs", name, {"holds": check.holds, "found": check.finding, "seconds": round(took)})
            print(f"{case.name}: {check.finding} ({took:.0f} s)", flush=True)


def computed_s():
    """Processor time of the programs that were run, which a busy machine does not lengthen."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def told(case, check):
    if not check.holds:
        sys.exit(f"{case.name}: {check.name}: {check.finding}")
    return check


def table(columns, numbers, rows):
    """A table whose last columns are numbers."""
    words = len(columns) - numbers
    return [f"| {' | '.join(columns)} |", "|" + " :--- |" * words + " ---: |" * numbers, *rows, ""]


def row(*cells):
    return f"| {' | '.join(map(str, cells))} |"


def write_tables():
    """Samples, sizes, and proofs."""
    samples, sizes, proofs = [], [], []
    for name, of in everything().items():
        words = name.split()
        cells = [of["cells"].get(chip, {"samples": 0}) for chip in (HERE, *CHIPS)]
        in_numpy = cells[0].get("samples_numpy", 0)
        in_llvm = cells[0].get("samples_llvm", "-")
        samples.append(row(*words, *(cell["samples"] for cell in cells), in_llvm, in_numpy))
        for chip, cell in zip(CHIPS, cells[1:], strict=True):
            if cell["samples"]:
                bytes_ = (f"{cell[key]}" for key in ("flash_bytes", "ram_bytes", "stack_bytes"))
                sizes.append(row(*words, of["form"], chip, *bytes_, cell["instructions"], f"{cell['ms_assumed']:.2g}"))
        if of["proofs"]:
            tasks = [of["proofs"].get(task) for task in ("rules", "bounds", "change")]
            cells = ("not run" if task is None else task["found"] for task in tasks)
            proofs.append(row(*words, *cells, sum(task["seconds"] for task in tasks if task)))
    case = ("Controller", "Guard", "Arithmetic")
    memory = ("Program and tables (B)", "State and workspace (B)", "Stack (B)")
    lines = (
        *table((*case, "Computer", "M4F", "M7", "RV32", "in LLVM", "in NumPy"), 6, samples),
        *table((*case, "Form", "Chip", *memory, "Instructions", "ms"), 5, sizes),
        *table((*case, "MISRA C:2012", "Dose and status", "Change of the rate", "Processor time (s)"), 1, proofs),
    )
    FIGURES.write_text("\n".join(lines), encoding="utf-8")


def main():
    given = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    given.add_argument("--controller", action="append", choices=list(CONTROLLERS), help="All, unless some are given.")
    given.add_argument("--guard", action="append", choices=list(GUARDS), help="All, unless some are given.")
    given.add_argument("--precision", choices=PRECISIONS, help="Both, unless one is given.")
    given.add_argument("--samples", type=int, default=10_000)
    given.add_argument("--proofs", action="store_true", help="Check MISRA C:2012 and prove the bounds instead.")
    given.add_argument("--tables", action="store_true", help="Write the tables alone.")
    asked = given.parse_args()
    keep_compiled()
    jax.config.update("jax_cpu_enable_async_dispatch", False)  # a step of a patient is too short for another thread
    chosen = [
        case
        for case in cases(asked.controller or CONTROLLERS)
        if asked.precision in (None, case.precision) and case.guard in (asked.guard or GUARDS)
    ]
    if asked.tables:
        write_tables()
    elif asked.proofs:
        prove(chosen)
    else:
        compare(chosen, asked.samples)


if __name__ == "__main__":
    main()
