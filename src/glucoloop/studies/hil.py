"""Hardware in the loop: the patient of a configured run here, its controller on a chip."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from glucoloop.config.hil import Hil
from glucoloop.control.protocol import gives_boluses
from glucoloop.experiments.surroundings import surroundings_of
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.hil.build import build, files, portable_files, refuse_missing_tools
from glucoloop.firmware.hil.link import Link, ProcessLink, SerialLink
from glucoloop.firmware.hil.loop import OnChip, Pace, run_on_chip
from glucoloop.firmware.hil.protocol import Payloads, plan_at
from glucoloop.simulation.stepped import scenario_stepper
from glucoloop.studies.closed_loop import Outcome, controller_for, integrator_of, model_for, outcome_of
from glucoloop.studies.exported import exported_controller
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
            "config": self.asked.keys(),
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
            return files(self.exported, self.asked.chip.chip)
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
    run, chip = asked.run, asked.chip
    if asked.emulated:
        refuse_missing_tools(chip.chip)
    situation = run.situation.situation()
    model = model_for(run, situation)
    controller = controller_for(run, situation, model)
    scenario = run.situation.scenario()
    around = surroundings_of(situation)
    stepper = scenario_stepper(
        situation.nominal,
        around.sensor,
        around.pump,
        scenario,
        sample_time_min=situation.sample_time_min,
        key=situation.seed,
        integrator=integrator_of(run.situation),
    )
    exported = exported_controller(run, chip, situation, controller, stepper)
    with _linked(asked, exported) as link:
        on_chip = run_on_chip(
            exported,
            stepper,
            scenario,
            link,
            gives_boluses=gives_boluses(controller),
            disturbances=asked.disturbances,
            seed=situation.seed,
            fallback=chip.fallback,
            pace=Pace(situation.sample_time_min, S_PER_MIN if chip.real_time else 0.0),
            progress=progress,
        )
    return HilOutcome(asked, outcome_of(run, situation, model, controller, on_chip.trace), exported, on_chip)


@contextlib.contextmanager
def _linked(asked: Hil, exported: Exported) -> Iterator[Link]:
    chip = asked.chip
    with contextlib.ExitStack() as stack:
        link: Link
        if asked.emulated:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="glucoloop-hil-")))
            program = build(exported, chip.chip, folder)
            link = ProcessLink(program, folder, plan_at(exported.source, Payloads(exported.source, exported.precision)))
        else:
            link = SerialLink(chip.chip, chip.baud)
        stack.callback(link.close)
        yield link
