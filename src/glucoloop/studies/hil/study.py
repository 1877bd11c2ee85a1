"""Hardware in the loop carried out: the patient of a run here, its controller on a chip."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import surroundings_of
from glucoloop.firmware.exported import Exported
from glucoloop.firmware.hil.build import build, files, portable_files, refuse_missing_tools
from glucoloop.firmware.hil.exchange import ANSWER_WITHIN_S, EMULATED_WITHIN_S
from glucoloop.firmware.hil.link import Link, ProcessLink, SerialLink
from glucoloop.firmware.hil.loop import OnChip, Pace, run_on_chip
from glucoloop.firmware.hil.protocol import Payloads, plan_at
from glucoloop.private_folder import private_temporary_folder
from glucoloop.simulation.stepper import scenario_stepper
from glucoloop.storage.results import Results
from glucoloop.studies.closed_loop import integrator_of, model_arguments, model_for, outcome_of
from glucoloop.studies.export import exported_controller
from glucoloop.studies.hil import Hil
from glucoloop.studies.run import study as run_study
from glucoloop.units import MU_PER_U, S_PER_MIN


@dataclass(frozen=True)
class _OnHardware(run_study.ClosedLoops):
    """The loop, with the files of the firmware."""

    firmware: Mapping[str, str] = field(default_factory=dict)


def amount(config: Hil) -> int:
    """Number of samples."""
    return config.samples


def results_of(config: Hil, progress: Callable[[int], None]) -> Results:
    """Design the controller, put it on its chip, and run the loop.

    Refusal if the controller cannot be designed or exported, a tool is missing, or the chip does not answer.
    """
    with contextlib.ExitStack() as open_links:
        board: Link | None = None
        if config.emulated:
            refuse_missing_tools(config.chip)
        else:  # opened before a design that takes long, since it may be no port
            board = open_links.enter_context(contextlib.closing(SerialLink(config.chip, config.baud)))
        case, scenario, surroundings = config.case, config.as_scenario(), surroundings_of(config)
        model = model_for(config, case)
        controller = controller_of(config, case, **model_arguments(model))
        stepper = scenario_stepper(
            config.nominal,
            surroundings.sensor,
            surroundings.pump,
            scenario,
            sample_time_min=config.sample_time_min,
            key=config.seed,
            integrator=integrator_of(config),
        )
        exported = exported_controller(config, case, controller, stepper)
        on_chip = run_on_chip(
            exported,
            stepper,
            scenario,
            open_links.enter_context(_emulated(config.chip, exported)) if board is None else board,
            disturbances=config.disturbances,
            seed=config.seed,
            fallback=config.fallback,
            pace=Pace(
                config.sample_time_min,
                S_PER_MIN if config.real_time else 0.0,
                EMULATED_WITHIN_S if config.emulated else ANSWER_WITHIN_S,
            ),
            progress=progress,
        )
    outcome = outcome_of(config, case, model, controller, on_chip.trace)
    plain = {
        **outcome.report(),
        "config": config.tree(whole=True),
        "chip": {
            "design": exported.source.design,
            "form": exported.source.form,
            "samples": len(on_chip.answered),
            "answered_in_time": sum(on_chip.answered),
            "equal_to_the_bit": on_chip.equal.count(True),
            "differing_samples": on_chip.differing,
            "late_boluses_mU": list(on_chip.late_boluses_mU),
            "sessions": list(on_chip.sessions),
            "counts": on_chip.counts,
            "samples_per_s": on_chip.samples_per_s,
        },
        "samples": config.samples,
        "holds": not on_chip.differing and not on_chip.counts["contradictions"],
    }
    loop = run_study.results_of_loop(outcome, plain, (*outcome.notes, *_lines(config, exported, on_chip)))
    firmware = files(exported, config.chip) if config.emulated else portable_files(exported)
    return dataclasses.replace(loop, extra=_OnHardware(loop.extra.outcomes, firmware=firmware))


@contextlib.contextmanager
def _emulated(chip: str, exported: Exported) -> Iterator[Link]:
    with private_temporary_folder("glucoloop-hil-") as folder:
        command = build(exported, chip, folder)
        plan = plan_at(exported.source, Payloads(exported.source, exported.precision))
        with contextlib.closing(ProcessLink(command, folder, plan)) as link:
            yield link


def files_of(config: Hil, results: Results) -> dict[str, bytes]:
    """Files of a run and of the firmware."""
    firmware = {name: text.encode() for name, text in results.extra.firmware.items()}
    return {**run_study.files_of(config, results), **firmware}


tables, sentences = run_study.tables, run_study.sentences


def _lines(config: Hil, exported: Exported, on_chip: OnChip) -> Iterator[str]:
    """The chip, its decisions and what befell it, one sentence each."""
    source, samples = exported.source, len(on_chip.answered)
    yield f"Chip: {config.chip}, design {source.design[:16]}, {source.form} form, {config.precision}."
    equal = on_chip.equal.count(True)
    yield f"{equal} of {samples} decisions are equal to the bit to those of the same controller without a chip."
    silent = samples - sum(on_chip.answered)
    if silent:
        yield (
            f"At {silent} of {samples} samples no decision came in time, and the pump gave its fallback rate "
            f"({config.fallback}); {on_chip.equal.count(None)} were never decided."
        )
    if on_chip.late_boluses_mU:
        late, late_U = len(on_chip.late_boluses_mU), sum(on_chip.late_boluses_mU) / MU_PER_U
        yield f"Boluses that were decided too late and not given: {late}, of {late_U:.3g} U together."
    if on_chip.differing:
        listed = ", ".join(map(str, on_chip.differing[:10]))
        yield f"Decisions differ at the samples {listed}; check the flags of the compiler."
    if on_chip.counts["contradictions"]:
        yield f"The chip contradicted itself {on_chip.counts['contradictions']} times; check its non-volatile memory."
    if len(on_chip.sessions) > 1:
        yield f"The chip lost its memory and began again at the samples {', '.join(map(str, on_chip.sessions[1:]))}."
    counts = [f"{number} {what}" for what, number in on_chip.counts.items() if number]
    if counts:
        yield f"Link and power: {', '.join(counts)}."
    yield f"Speed: {on_chip.samples_per_s:.3g} samples/s."
