"""``glucoloop export``: a controller in C, with recorded samples, a self-test and a report of the checks."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import (
    ALLOW_CODE,
    CASE,
    OUTPUT,
    SITUATION,
    Given,
    Option,
    names,
    options_of,
    with_options,
    without,
)
from glucoloop.cli.request import file_keys, keys_used, read_again, split_off_output, with_lists
from glucoloop.cli.screen import stage
from glucoloop.cli.telling import note_on_boluses
from glucoloop.config.key import declared, own_keys
from glucoloop.config.options.export import ChipKeys
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.config.export import Export

HELP: Final = (
    "Write a controller in C for a microcontroller, with recorded samples and a self-test.\n\n"
    "The controller is designed as `glucoloop run` designs it. The folder holds one C file and its header, samples of "
    "a closed loop with faults and the expected bits of every dose, a Makefile, the numbers of the controller as CSV, "
    "and what was checked. `make test` needs only a C compiler, `make qemu` a cross compiler and QEMU.\n\n"
    "  glucoloop export --controller mpc-se --guard --target cortex-m4f --out pump\n\n"
    "  glucoloop export --check pump --samples 10000"
)
_TAKEN: Final = ("meals", "duration_min", "integrator", "faults", "metrics", "initial_glucose_mg_dl")
"""Options of a run that do not concern a controller: the recorded samples have meals and faults of their own."""
OPTIONS: Final = (
    *options_of(ChipKeys),
    Option(
        "check",
        "--check",
        str,
        "Check a folder that was written before, with all that is installed: NumPy, the native engine, C on this "
        "computer and in QEMU, MISRA C by cppcheck, and bounds of the dose by Frama-C.",
        "Chip",
        metavar="DIR",
    ),
    *without((*SITUATION, *CASE), *_TAKEN),
    *OUTPUT,
)


@with_options(OPTIONS)
def command(given: Given) -> None:
    """Check the request, write or check the folder, and print the results."""
    if "check" in given:
        _check(given)
        return
    keys, output, file = split_off_output(given)
    asked = read_again(_read, keys_used, with_lists(keys), file_keys(file))
    note_on_boluses(asked.run.situation.patient, [asked.run.case.controller])
    with output.folder() as folder:
        if folder is None:
            raise Refusal("an exported controller is a folder; name one with --out")
        with stage("Importing the simulator"):
            from glucoloop.cli.compiled import keep_compiled
            from glucoloop.cli.exported import report, tell, write
        keep_compiled()
        with stage("Designing the controller, and writing it in C"):
            written = write(asked, folder)
        files = folder.paths()
    if output.json:
        from glucoloop.cli.telling import print_json

        print_json(report(written), files, ())
    else:
        tell(written, output.out, files)
    if any(rung.holds is False for rung in written.rungs):
        sys.exit(1)


def _read(keys: Given, of_file: Given) -> Export:
    from glucoloop.config.export import read_export
    from glucoloop.config.run import overlay

    called = names(OPTIONS, keys)
    chip = own_keys({**of_file, **keys}, ChipKeys)
    lower, upper = ({k: v for k, v in of.items() if k not in declared(ChipKeys)} for of in (of_file, keys))
    run = overlay(lower, upper, called)
    return read_export({**run, **chip}, called)


def _check(given: Given) -> None:
    extra = sorted(given.keys() - {"check", "samples", "json", "target", ALLOW_CODE.key})
    if extra:
        called = ", ".join(names(OPTIONS, {key: given[key] for key in extra}).values())
        raise Refusal(f"--check reads how the controller was designed from the folder; leave out {called}")
    folder = Path(str(given["check"]))
    with stage("Importing the simulator"):
        from glucoloop.cli.compiled import keep_compiled
        from glucoloop.cli.exported import check, tell_rungs
        from glucoloop.config.export import read_export
    configuration = folder / "run.toml"
    if not configuration.is_file():
        raise Refusal(f"{folder} holds no run.toml; give a folder that `glucoloop export --out` wrote")
    asked = read_again(lambda _, of_file: read_export(of_file), keys_used, {}, file_keys(configuration))
    chosen: Given = {key: given[key] for key in ("samples", "target") if key in given}
    wanted = read_export({**asked.keys(), **chosen}, names(OPTIONS, given))
    keep_compiled()
    with stage("Checking"):
        rungs = check(asked, folder, wanted.chip.samples, wanted.chip.target)
    if given.get("json"):
        from glucoloop.storage.strict_json import json_text, with_version

        print(json_text(with_version({"folder": str(folder), "checks": [rung.as_dict() for rung in rungs]})))
    else:
        tell_rungs(rungs)
    sys.exit(1 if any(rung.holds is False for rung in rungs) else 0)
