"""``glucoloop hil``: the patient here, the controller on a chip."""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from glucoloop.cli.command import Command
from glucoloop.cli.option import MMOL, OUTPUT, SHORT, Given, options_of, reworded
from glucoloop.cli.progress import counted
from glucoloop.cli.request import completed, request_of
from glucoloop.cli.run import tell, write_outcome
from glucoloop.cli.screen import stage
from glucoloop.situations.request import asked_for, read_root
from glucoloop.studies.hardware import Hil

if TYPE_CHECKING:
    from glucoloop.studies.hil import HilOutcome

HELP: Final = (
    "Close the loop with the controller on a chip: hardware in the loop.\n\n"
    "The patient, its sensor and its pump are simulated here as `glucoloop run` does it. The controller runs as C on "
    "an emulated chip, as a process of this computer (`host`), or on a board at a serial port, and gets each reading "
    "over a serial link. Frames may be damaged, lost, doubled or late, and the power of the chip may fail at any "
    "moment; every decision is compared with the same controller without a chip, to the bit.\n\n"
    "  glucoloop hil --controller mpc-se --guard --chip cortex-m4f --out first\n\n"
    "  glucoloop hil --controller pid --duration 1440 --power-cuts 1000 --damaged 100 --outages 5 --out night\n\n"
    "  glucoloop hil --config first/run.toml --chip /dev/ttyACM0 --real-time"
)
_SELDOM: Final = (
    "precision", "form", "baud", "damaged", "lost", "doubled", "late", "initial_glucose_mg_dl", "announce_meals",
    "sample_time_min", "allow_unusual",
)  # fmt: skip
OPTIONS: Final = (*reworded(options_of(Hil), rare=dict.fromkeys(_SELDOM, True)), *SHORT, *OUTPUT, MMOL)


def _hil(typed: Given) -> None:
    """Check the request, run the loop, write and print the results."""
    request = request_of(typed, OPTIONS)
    read_root(Hil, request.tree)
    output, files = request.output, dict[str, str]()
    with output.folder() as folder:
        asked: Hil = completed(request, functools.partial(asked_for, Hil))
        from glucoloop.studies.hil import run_hardware

        with counted(asked.samples, 0, "samples") as progress:
            found = run_hardware(asked, progress)
        if folder is not None:
            with stage("Drawing"):
                write_outcome(folder, asked, found.outcome, output, found.report(), "hil")
                for name, text in found.firmware().items():
                    folder.write(name, text)
            files = folder.paths()
    tell(found.outcome, output, files, found.report(), _lines(found))
    if not found.holds:
        sys.exit(1)


def _lines(found: HilOutcome) -> Iterator[str]:
    """The chip, its decisions and what befell it, one sentence each."""
    on_chip, source, asked = found.on_chip, found.exported.source, found.asked
    samples, equal = len(on_chip.answered), on_chip.equal.count(True)
    yield f"Chip: {asked.chip}, design {source.design[:16]}, {source.form} form, {asked.precision}."
    yield f"{equal} of {samples} decisions are equal to the bit to those of the same controller without a chip."
    silent = samples - sum(on_chip.answered)
    if silent:
        yield (
            f"At {silent} of {samples} samples no decision came in time, and the pump gave its fallback rate "
            f"({asked.fallback}); {on_chip.equal.count(None)} were never decided."
        )
    if on_chip.differing:
        told = ", ".join(map(str, on_chip.differing[:10]))
        yield f"Decisions differ at the samples {told}; check the flags of the compiler."
    if on_chip.counts["contradictions"]:
        yield f"The chip contradicted itself {on_chip.counts['contradictions']} times; check its non-volatile memory."
    if len(on_chip.sessions) > 1:
        yield f"The chip lost its memory and began anew at the samples {', '.join(map(str, on_chip.sessions[1:]))}."
    counts = [f"{number} {what}" for what, number in on_chip.counts.items() if number]
    if counts:
        yield f"Link and power: {', '.join(counts)}."
    yield f"Speed: {on_chip.samples_per_s:.3g} samples/s."


HIL: Final = Command("hil", HELP, OPTIONS, _hil, more="hil")
