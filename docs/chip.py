"""Measure exported controllers with every tool that is installed, and write the tables of ``guide/chip.md``.

    python docs/chip.py --samples 120 imc pid mpc mpc-se nlqdmc-se meal-mpc
    python docs/chip.py --precision float64 --samples 120 mpc-se

Each controller with its guard runs over so many samples of a closed loop with faults, of which the last sixth is told
absurd numbers, in C on this computer and on every emulated chip; then MISRA and the proofs are checked. A row is
written into ``guide/chip_figures.md`` as soon as a controller is done, in the place of an older one. The compilers,
QEMU, cppcheck and Frama-C that the page names are needed.
"""

import argparse
import sys
import time
from pathlib import Path

from glucoloop.cli.exported import made_of
from glucoloop.config.export import read_export
from glucoloop.firmware.analysis import bounds_proved, change_proved, misra
from glucoloop.firmware.chips import CHIPS
from glucoloop.firmware.ladder import emulated

FIGURES = Path(__file__).resolve().parent / "guide" / "chip_figures.md"
SIZES = (
    "| Controller, guarded | Arithmetic | Form | Chip | Samples | Program and tables | State and workspace | Stack "
    "| Instructions | ms |",
    "| :--- | :--- | :--- | :--- |" + " ---: |" * 6,
)
PROOFS = (
    "| Controller, guarded | Arithmetic | MISRA C:2012 | Dose and status | Change of the rate | Proofs took |",
    "| :--- | :--- | :--- | :--- | :--- | ---: |",
)


def rows_of(controller, precision, samples):
    """Rows of both tables; every check must hold."""
    wanted = {"controller": controller, "guard": True, "precision": precision, "samples": samples}
    made = made_of(read_export(wanted))
    record = made.recorded(samples, 0)
    sizes = []
    for chip in CHIPS.values():
        found = told(emulated(made.exported, record, chip)).measured
        cells = (
            controller,
            precision,
            made.exported.source.form,
            chip.name,
            f"{found['samples']}",
            f"{found['flash_bytes']} B",
            f"{found['ram_bytes']} B",
            f"{found['stack_bytes']} B",
            f"{found['instructions']}",
            f"{found['ms_assumed']:.2g}",
        )
        sizes.append(f"| {' | '.join(cells)} |")
    rules = told(misra(made.exported, record)).found
    start = time.perf_counter()
    proofs = [told(prove(made.exported, record)).found for prove in (bounds_proved, change_proved)]
    took = f"{time.perf_counter() - start:.0f} s"
    return sizes, f"| {' | '.join((controller, precision, rules, *proofs, took))} |"


def told(rung):
    if not rung.holds:
        sys.exit(f"{rung.check}: {rung.found}")
    return rung


def main():
    given = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    given.add_argument("--precision", choices=("float32", "float64"), default="float32")
    given.add_argument("--samples", type=int, default=120)
    given.add_argument("controllers", nargs="+")
    asked = given.parse_args()
    for controller in asked.controllers:
        sizes, proof = rows_of(controller, asked.precision, asked.samples)
        old = FIGURES.read_text(encoding="utf-8").split("\n\n") if FIGURES.is_file() else ["", ""]
        begin = f"| {controller} | {asked.precision} |"
        kept = [[row for row in part.splitlines()[2:] if not row.startswith(begin)] for part in old]
        parts = ([*SIZES, *kept[0], *sizes], [*PROOFS, *kept[1], proof])
        FIGURES.write_text("\n\n".join("\n".join(part) for part in parts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
