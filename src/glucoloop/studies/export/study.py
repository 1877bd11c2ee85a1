"""Design, writing and report of an exported controller."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from glucoloop.build.designs import controller_of
from glucoloop.control.protocol import computed_settings
from glucoloop.firmware.checks import CHECKED, INTERPRETED, Check, checks_of, chips_for
from glucoloop.firmware.chips import chip_of
from glucoloop.firmware.folder import code_files, numbers_table, proof, readme
from glucoloop.firmware.safety import safety_report
from glucoloop.firmware.samples import Init, SampleRecord, Step, arithmetic, record, stepper_of
from glucoloop.models.settings import FileComponent
from glucoloop.native.targets.c.host import Library, compiler
from glucoloop.situations.toml import toml_text
from glucoloop.storage.files import json_text, read_text, with_version
from glucoloop.storage.folder import OutputFolder
from glucoloop.studies.closed_loop import model_arguments, model_for
from glucoloop.studies.export import Export, exported_controller, name_of


class Made:
    """A designed controller and its C."""

    def __init__(self, config: Export) -> None:
        self.config, case = config, config.case
        self.model = model_for(config, case)
        self.controller = controller_of(config, case, **model_arguments(self.model))
        self.settled = computed_settings(self.controller)
        self.exported = exported_controller(config, case, self.controller, stepper_of(config, 0))

    @functools.cached_property
    def computing(self) -> tuple[Init, Step]:
        """Init and step in C on this computer, compiled once, or in NumPy where it has no compiler."""
        if compiler() is None:
            return arithmetic(self.exported)
        library = Library(self.exported.source, self.exported.precision)
        return library.init, library.step

    def recorded(self, samples: int, seed: int) -> SampleRecord:
        """Samples of a closed loop, with the decisions of the controller's C on this computer."""
        init, step = self.computing
        return record(self.exported, self.controller, self.config, init, step, samples=samples, seed=seed)


def write(config: Export, folder: OutputFolder, notes: Sequence[str]) -> tuple[Made, list[Check]]:
    """Design a controller, write it in C, run the quick checks, and write the folder; returns it and the checks."""
    made, chip = Made(config), chip_of(config.target)
    exported = made.exported
    chips, of_loop = [] if chip is None else [chip], made.recorded(config.samples, config.seed)
    checks = list(checks_of(exported, of_loop, chips, samples=INTERPRETED[exported.source.form], deep=False))
    for file, text in code_files(exported, of_loop, chip).items():
        folder.write(file, text)
    folder.write("controller.csv", numbers_table(made.controller))
    name, guarded = name_of(config, config.case), config.case.guard is not None
    outcomes = [check.as_dict() for check in checks]
    folder.write("README.md", readme(exported, name, config.sample_time_min, chip, outcomes, guarded=guarded))
    folder.write("PROOF.md", proof(exported, name, outcomes))
    folder.write("SAFETY.md", safety_report(exported, name, outcomes, guarded=guarded))
    folder.write("manifest.json", json_text(with_version(report(made, checks, notes))) + "\n")
    used, explicit = config.tree(whole=True), config.tree()
    used["controller"][0].update({"settled": made.settled} if made.settled else {})
    if made.model is not None:
        folder.write("model.json", made.model.text())
        if isinstance(config.case.model, FileComponent):
            used["controller"][0]["model"] = explicit["model"] = {"name": FileComponent.name, "path": "model.json"}
    folder.write("run.toml", toml_text(used, "export --config run.toml --out DIR", explicit))
    return made, checks


def report(made: Made, checks: Sequence[Check], notes: Sequence[str]) -> dict[str, Any]:
    """Plain values for JSON."""
    exported, source = made.exported, made.exported.source
    return {
        "config": made.config.tree(whole=True),
        "settled": made.settled,
        "design": source.design,
        "form": source.form,
        "precision": exported.precision,
        "state_bytes": source.record_bytes - 20,
        "workspace_numbers": dict(source.workspace),
        "checks": [check.as_dict() for check in checks],
        "notes": list(notes),
    }


def check(config: Export, folder: Path) -> list[Check]:
    """Design the controller of a folder again, and run all checks."""
    made = Made(config)
    exported, name = made.exported, "the design of the folder gives its C file again"
    same = read_text(folder / "controller.c", "a controller") == exported.source.code
    results = f"design {exported.source.design[:16]}"
    if not same:
        results = (
            "controller.c is another file than the one that this version of glucoloop writes on this computer; "
            "a design made on another kind of processor may differ in its last digits"
        )
    chips, of_loop = chips_for(chip_of(config.target)), made.recorded(config.samples, config.seed)
    return [
        Check(name, same, results, {}),
        *checks_of(exported, of_loop, chips, samples=CHECKED[exported.source.form], deep=True),
    ]
