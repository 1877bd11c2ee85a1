"""The program: its commands and its exit codes."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Final, NoReturn

import typer

import glucoloop
from glucoloop.arithmetic import pin
from glucoloop.cli import (
    adversary,
    compare,
    detect,
    export,
    hil,
    identify,
    lab,
    listing,
    query,
    reproduce,
    run,
    trial,
)
from glucoloop.cli.declared import command_of
from glucoloop.cli.interrupts import heeded
from glucoloop.cli.mistakes import BUG, interrupted, mistake, sentence
from glucoloop.cli.options import ALLOW_CODE
from glucoloop.cli.results import forgotten
from glucoloop.cli.screen import note
from glucoloop.cli.whole_names import WholeNames
from glucoloop.parts.code import only_code
from glucoloop.storage.trials.stoppable import left_behind
from glucoloop.studies.catalogue import STUDIES

USAGE_ERRORS: Final[type[Exception]] = typer.BadParameter.__bases__[0]
"""Typer hands out only this one of its usage errors; the others share its base."""

app = typer.Typer(
    name="glucoloop",
    help=(
        "An open laboratory for automatic insulin dosing: identify a model of a virtual patient, close the loop, "
        "compare controllers, try them on a population. Research software, not a medical device."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_BEFORE: Final = {"run": run, "list": listing, "identify": identify, "compare": compare, "trial": trial}
_STUDIES: Final = {
    "detect": detect,
    "adversary": adversary,
}
_AFTER: Final = {"export": export, "hil": hil, "lab": lab, "query": query, "reproduce": reproduce}
for _name, _module in {**_BEFORE, **_STUDIES}.items():
    app.command(_name, help=_module.HELP)(_module.command)
for _study in STUDIES:
    app.command(_study.name, help=_study.help)(command_of(_study))
for _name, _module in _AFTER.items():
    app.command(_name, help=_module.HELP)(_module.command)
for _registered in app.registered_commands:
    _registered.cls = WholeNames


def _tell_version(asked: bool) -> None:
    if asked:
        typer.echo(f"glucoloop {glucoloop.__version__}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and leave.", callback=_tell_version, is_eager=True)
    ] = False,
) -> None:
    del version


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command and exit: 0 for success, 2 for a mistake of the user, 130 for an interrupt; a bug raises (1)."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    with forgotten(), only_code(_typed(arguments)):
        _main(arguments)


def _typed(arguments: Sequence[str]) -> Callable[[str], bool]:
    """Whether a name of code stands on the command line, or all are allowed there."""
    if ALLOW_CODE.flag in arguments:
        return lambda name: True
    return lambda name: any(re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.:])", text) for text in arguments)


def _main(arguments: list[str]) -> NoReturn:
    _open_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        # What the terminal or the pipe has no character for is told as its escape, as on standard error.
        sys.stdout.reconfigure(errors="backslashreplace")
    if any("\0" in argument for argument in arguments):
        mistake("an argument holds a NUL character, which no name or number does; leave it out")
    note(pin())
    try:
        with heeded():
            code = app(args=arguments, prog_name="glucoloop", standalone_mode=False)
    except USAGE_ERRORS as error:
        _leave_usage(error, arguments)
    except (KeyboardInterrupt, typer.Abort):
        interrupted()
    except Exception as error:
        told = sentence(error)
        if told is None:
            error.add_note(BUG)
            raise
        mistake(told)
    # Typer turns an interrupt into this code when it is not to leave by itself.
    if code == 130:
        interrupted()
    sys.exit(code or 0)


def _open_streams() -> None:
    """Discard output to a stream that was closed before the program began, for which Python has None."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (for as long as the program)


def program() -> None:
    """The command as a process: like `main`, but an interrupted one ends at once.

    A regular exit of the interpreter would tear down threads of JAX that still compute, which sometimes crashes; and it
    would wait for work that does not stop.
    """
    try:
        main()
    except SystemExit as leaving:
        if leaving.code != 130 and not left_behind():
            raise
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(leaving.code if isinstance(leaving.code, int) else 0)


def _leave_usage(error: Exception, arguments: Sequence[str]) -> None:
    told = str(getattr(error, "format_message", error.__str__)()).strip()
    if not told:  # no arguments: the help has been shown
        sys.exit(2)
    commands = {command.name for command in app.registered_commands}
    named = [argument for argument in arguments if argument in commands][:1]
    told = " ".join(told.split()).rstrip(".")
    mistake(f"{told}{' see' if told.endswith('?') else '; see'} {' '.join(['glucoloop', *named, '--help'])}")
