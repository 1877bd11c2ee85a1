"""Hardware in the loop carried out: the patient of a run here, its controller on a chip."""

from __future__ import annotations

import contextlib
import dataclasses
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from glucoloop.control.protocol import gives_boluses
from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.surroundings import surroundings_of
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.hil.build import build, files, portable_files, refuse_missing_tools
from glucoloop.firmware.hil.link import Link, ProcessLink, SerialLink
from glucoloop.firmware.hil.loop import OnChip, Pace, run_on_chip
from glucoloop.firmware.hil.protocol import Payloads, plan_at
from glucoloop.simulation.stepper import scenario_stepper
from glucoloop.storage.findings import Findings
from glucoloop.studies.closed_loop import Outcome, integrator_of, model_arguments, model_for, outcome_of
from glucoloop.studies.exported import exported_controller
from glucoloop.studies.hil import Hil
from glucoloop.studies.run import study as run_study
from glucoloop.units import S_PER_MIN


@dataclass(frozen=True)
class HilOutcome:
    """A run with its controller on a chip."""

    asked: Hil
    outcome: Outcome
    exported: Exported
    on_chip: OnChip

    @property
    def holds(self) -> bool:
        """Whether every decision has the bits of the controller without a chip."""
        return not self.on_chip.differing and not self.on_chip.counts["contradictions"]

    def report(self) -> dict[str, Any]:
        """Plain values for JSON."""
        on_chip = self.on_chip
        return {
            **self.outcome.report(),
            "config": self.asked.tree(whole=True),
            "chip": {
                "design": self.exported.source.design,
                "form": self.exported.source.form,
                "samples": len(on_chip.answered),
                "answered_in_time": sum(on_chip.answered),
                "equal_to_the_bit": on_chip.equal.count(True),
                "differing_samples": on_chip.differing,
                "sessions": list(on_chip.sessions),
                "counts": on_chip.counts,
                "samples_per_s": on_chip.samples_per_s,
            },
        }

    def firmware(self) -> dict[str, str]:
        """Files of the firmware."""
        if self.asked.emulated:
            return files(self.exported, self.asked.chip)
        return portable_files(self.exported)


def run_hardware(asked: Hil, progress: Callable[[int], None] = lambda samples: None) -> HilOutcome:
    """Design the controller, put it on its chip, and run the loop.

    Parameters
    ----------
    asked : Hil
    progress : callable
        Called with the number of samples that were done.

    Raises
    ------
    ValueError
        If the controller cannot be designed or exported, a tool is missing, or the chip does not answer.
    """
    if asked.emulated:
        refuse_missing_tools(asked.chip)
        return _run(asked, None, progress)
    # opened before a design that takes long, since it may be no port
    with contextlib.closing(SerialLink(asked.chip, asked.baud)) as board:
        return _run(asked, board, progress)


def _run(asked: Hil, board: Link | None, progress: Callable[[int], None]) -> HilOutcome:
    """Design the controller and run the loop, on a board or on the emulated chip."""
    case = asked.case
    model = model_for(asked, case)
    controller = controller_of(asked, case, **model_arguments(model))
    scenario = asked.scenario()
    around = surroundings_of(asked)
    stepper = scenario_stepper(
        asked.nominal,
        around.sensor,
        around.pump,
        scenario,
        sample_time_min=asked.sample_time_min,
        key=asked.seed,
        integrator=integrator_of(asked),
    )
    exported = exported_controller(asked, case, controller, stepper)
    with contextlib.nullcontext(board) if board is not None else _emulated(asked.chip, exported) as link:
        on_chip = run_on_chip(
            exported,
            stepper,
            scenario,
            link,
            gives_boluses=gives_boluses(controller),
            disturbances=asked.disturbances,
            seed=asked.seed,
            fallback=asked.fallback,
            pace=Pace(asked.sample_time_min, S_PER_MIN if asked.real_time else 0.0),
            progress=progress,
        )
    return HilOutcome(asked, outcome_of(asked, case, model, controller, on_chip.trace), exported, on_chip)


@contextlib.contextmanager
def _emulated(chip: str, exported: Exported) -> Iterator[Link]:
    with tempfile.TemporaryDirectory(prefix="glucoloop-hil-") as name:
        folder = Path(name)
        command = build(exported, chip, folder)
        plan = plan_at(exported.source, Payloads(exported.source, exported.precision))
        with contextlib.closing(ProcessLink(command, folder, plan)) as link:
            yield link


def notes(asked: Hil) -> tuple[str, ...]:
    """Return no sentence; what is to be noted follows from the loop."""
    return ()


def amount(asked: Hil) -> int:
    """Number of samples."""
    return asked.samples


def found(asked: Hil, progress: Callable[[int], None]) -> Findings:
    """Close the loop with the controller on its chip."""
    of = run_hardware(asked, progress)
    plain = {**of.report(), "samples": amount(asked), "holds": of.holds}
    loop = run_study.findings(of.outcome, plain, (*of.outcome.notes, *_lines(of)))
    return dataclasses.replace(loop, extra=OnHardware(loop.extra.outcomes, hardware=of))


@dataclass(frozen=True)
class OnHardware(run_study.ClosedLoops):
    """The loop, with what the chip did."""

    hardware: HilOutcome | None = None


def drawn(asked: Hil, found: Findings, *, mmol: bool = False) -> dict[str, bytes]:
    """Files of a run and of the firmware."""
    firmware = found.extra.hardware.firmware()
    return {**run_study.drawn(asked, found, mmol=mmol), **{name: text.encode() for name, text in firmware.items()}}


tables, sentences, mmol_lines = run_study.tables, run_study.sentences, run_study.mmol_lines


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
        listed = ", ".join(map(str, on_chip.differing[:10]))
        yield f"Decisions differ at the samples {listed}; check the flags of the compiler."
    if on_chip.counts["contradictions"]:
        yield f"The chip contradicted itself {on_chip.counts['contradictions']} times; check its non-volatile memory."
    if len(on_chip.sessions) > 1:
        yield f"The chip lost its memory and began anew at the samples {', '.join(map(str, on_chip.sessions[1:]))}."
    counts = [f"{number} {what}" for what, number in on_chip.counts.items() if number]
    if counts:
        yield f"Link and power: {', '.join(counts)}."
    yield f"Speed: {on_chip.samples_per_s:.3g} samples/s."
