"""``glucoloop export``: a controller in C, with recorded samples, a self-test and a report of the checks."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from glucoloop.cli.command import ALLOW_CODE, OUTPUT, Command, CommandOption, Given, options_of
from glucoloop.cli.request import command_request, configuration_of, notes_without_effect
from glucoloop.cli.screen import note, print_json, print_text, print_value, stage, where_written
from glucoloop.component.request import read_root
from glucoloop.refusal import Refusal
from glucoloop.situations.run import intravenous_boluses
from glucoloop.studies.export import Export

if TYPE_CHECKING:
    from glucoloop.firmware.checks import Check

HELP: Final = (
    "Write a controller in C for a microcontroller, with recorded samples and a self-test.\n\n"
    "The controller is designed as `glucoloop run` designs it. The folder holds one C file and its header, samples of "
    "a closed loop with faults and the expected bits of every dose, a Makefile, the numbers of the controller as CSV, "
    "and what was checked. `make test` needs only a C compiler, `make qemu` a cross compiler and QEMU.\n\n"
    "  glucoloop export --controller mpc-se --guard --target cortex-m4f --out pump\n\n"
    "  glucoloop export --check pump --samples 10000"
)
_CHECK: Final = CommandOption(
    "check",
    "--check",
    "Check a folder that was written before, with all that is installed: NumPy, the native engine, C on this computer "
    "and in QEMU, MISRA C by cppcheck, and bounds of the dose by Frama-C.",
    panel="Chip",
    metavar="DIR",
)
OPTIONS: Final = (_CHECK, *options_of(Export), *OUTPUT)


def _export(typed: Given) -> None:
    """Check the request, write or check the folder, and print the results."""
    if _CHECK.key in typed:
        _check(typed)
        return
    request = command_request(typed, OPTIONS)
    read_root(Export, request.tree)
    output = request.output
    if output.place is None:
        raise Refusal("an exported controller is a folder; name one with --out")
    with output.folder("run.toml", "controller.c") as folder:
        assert folder is not None
        config = configuration_of(request, Export)
        without_effect = notes_without_effect(config)
        note((*intravenous_boluses(config), *without_effect))
        from glucoloop.studies.export.study import report, write

        with stage("Designing the controller, and writing it in C"):
            made, checks = write(config, folder, without_effect)
        files = folder.paths()
    if output.json:
        print_json(report(made, checks, without_effect), files)
    else:
        exported = made.exported
        print_text(f"Design {exported.source.design[:16]}, {exported.source.form} form, {exported.precision}.")
        _print_checks(checks)
        print_text(where_written(output.out, files))
    if any(check.holds is False for check in checks):
        sys.exit(1)


def _check(typed: Given) -> None:
    extra = sorted(typed.keys() - {_CHECK.key, "samples", "json", "target", ALLOW_CODE.key})
    if extra:
        called = ", ".join(option.flag for option in OPTIONS if option.key in extra)
        raise Refusal(f"--check reads how the controller was designed from the folder; leave out {called}")
    folder = Path(str(typed[_CHECK.key]))
    configuration = folder / "run.toml"
    if not configuration.is_file():
        raise Refusal(f"{folder} holds no run.toml; give a folder that `glucoloop export --out` wrote")
    chosen: Given = {key: typed[key] for key in typed if key in ("samples", "target")}
    config = configuration_of(command_request({"config": str(configuration), **chosen}, OPTIONS), Export)
    from glucoloop.studies.export.study import check

    with stage("Checking"):
        checks = check(config, folder)
    if typed.get("json"):
        from glucoloop.storage.files import with_version

        print_value(with_version({"folder": str(folder), "checks": [check.as_dict() for check in checks]}))
    else:
        _print_checks(checks)
    sys.exit(1 if any(check.holds is False for check in checks) else 0)


def _print_checks(checks: Iterable[Check]) -> None:
    """Print one line for each check."""
    for check in checks:
        verdict = {True: "holds", False: "does not hold", None: "not run"}[check.holds]
        print_text(f"{verdict:>13}  {check.name}: {check.finding}.")


EXPORT: Final = Command("export", HELP, OPTIONS, _export, more="export")
