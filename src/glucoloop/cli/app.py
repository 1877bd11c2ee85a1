"""The program: its commands and its exit codes."""

from __future__ import annotations

import importlib
import io
import os
import re
import signal
import sys
import textwrap
import traceback
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Final, NoReturn

import glucoloop
from glucoloop.cli.command import Command
from glucoloop.cli.errors import BUG, COMMAND, KEPT_RESULTS, interrupted, mistake, sentence
from glucoloop.cli.interrupts import catching_interrupts
from glucoloop.cli.screen import note, print_text, width_of_text
from glucoloop.component.code import loaded, only_code
from glucoloop.component.setting import known_names
from glucoloop.refusal import Refusal
from glucoloop.studies.catalogue import CARRY_ON, LIMITS, MODELS, RESULTS, SAFETY, SIMULATE, STUDIES, CommandEntry

_ALLOW_CODE: Final = "--allow-code"
_HELP: Final = ("-h", "--help")
_INTRO: Final = (
    "An open laboratory for automatic insulin dosing: identify a model of a virtual patient, close the loop, compare "
    "controllers, try them on a population. Research software, not a medical device."
)
COMMANDS: Final = {
    "lab": CommandEntry("glucoloop.cli.lab:LAB", SIMULATE, "Write the laboratory as one page, for the browser."),
    "list": CommandEntry("glucoloop.cli.listing:LIST", MODELS, "List all components, and the settings of each."),
    "export": CommandEntry("glucoloop.cli.export:EXPORT", CARRY_ON, "Write a controller as C for a microcontroller."),
    "records": CommandEntry("glucoloop.cli.records:RECORDS", MODELS, "Read records of sensors, pumps and apps."),
    "cite": CommandEntry("glucoloop.cli.cite:CITE", RESULTS, "Print what to cite for a run, as BibTeX."),
    "cache": CommandEntry("glucoloop.cli.cache:CACHE", RESULTS, "Say what is kept for the next start, or remove it."),
    "query": CommandEntry("glucoloop.cli.query:QUERY", RESULTS, "Query the folder of a trial in SQL."),
}
_GROUPS: Final = (SIMULATE, MODELS, SAFETY, LIMITS, CARRY_ON, RESULTS)


def _by_group() -> dict[str, dict[str, CommandEntry]]:
    every = {**COMMANDS, **STUDIES}
    return {group: {name: entry for name, entry in every.items() if entry.group == group} for group in _GROUPS}


def names() -> list[str]:
    """Names of all commands, in the order of the help."""
    return [name for entries in _by_group().values() for name in entries]


def _program_help() -> str:
    """Help of the program: its commands in groups, a sentence each."""
    lines = ["Usage: glucoloop COMMAND [OPTIONS]", "", *textwrap.wrap(_INTRO, width_of_text()), ""]
    for group, entries in _by_group().items():
        lines += [f"{group}:", *(f"  {name:<11} {entry.summary}" for name, entry in entries.items()), ""]
    lines.append("glucoloop COMMAND --help explains a command; glucoloop --version shows the version.")
    return "\n".join(lines) + "\n"


def command_of(name: str) -> Command:
    """A command by its name; Refusal for an unknown one."""
    if name in STUDIES:
        from glucoloop.cli.study_command import command_of_study

        return command_of_study(loaded(STUDIES[name].place))
    if name not in COMMANDS:
        if name.startswith("-"):
            raise Refusal(f"there is no option {name} before a command; see glucoloop --help")
        raise Refusal(f"there is no command {name!r}; {known_names(name, names())}")
    module, _, attribute = COMMANDS[name].place.partition(":")
    results: Command = getattr(importlib.import_module(module), attribute)
    return results


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command and exit: 0 for success, 2 for a mistake of the user, 130 for an interrupt; a bug raises (1)."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    _prepare_streams()
    KEPT_RESULTS.set(None)
    COMMAND.set(None)
    with only_code(_is_allowed(arguments)):
        if any("\0" in argument for argument in arguments):
            mistake("an argument holds a NUL character, which no name or number does; leave it out")
        try:
            with catching_interrupts():
                code = _carry_out(arguments)
                sys.stdout.flush()
        except KeyboardInterrupt:
            interrupted()
        except BrokenPipeError:
            _reader_left()
        except Exception as error:
            message = sentence(error)
            if message is None:
                error.add_note(BUG)
                raise
            mistake(message)
        sys.exit(code)


def _reader_left() -> NoReturn:
    """Exit as other programs do whose output nobody reads any more, as with ``| head``: in silence."""
    sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 (Python would try again at the end)
    sys.exit(128 + signal.SIGPIPE if hasattr(signal, "SIGPIPE") else 1)


def _is_allowed(arguments: Sequence[str]) -> Callable[[str], bool]:
    """Function that says whether a name of code stands on the command line, or all are allowed there."""
    if _ALLOW_CODE in arguments:
        return lambda name: True
    return lambda name: any(re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.:])", text) for text in arguments)


def _prepare_streams() -> None:
    """Discard output to a stream that was closed before the program began, for which Python has None.

    What the terminal or the pipe has no character for is told as its escape, as on standard error.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (for as long as the program)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _carry_out(arguments: Sequence[str]) -> int:
    """Carry out what the arguments ask for; returns the exit code."""
    if not arguments or arguments[0] in _HELP:
        print_text(_program_help(), end="")
        return 0 if arguments else 2
    if arguments[0] == "--version":
        print_text(f"glucoloop {glucoloop.__version__}")
        return 0
    command, rest = command_of(arguments[0]), arguments[1:]
    COMMAND.set((command.name, frozenset((*_HELP, *(option.flag for option in command.options)))))
    if any(argument in _HELP for argument in rest):
        print_text(command.help(), end="")
        return 0
    from glucoloop.arithmetic import pin

    given = command.given(rest)
    note(pin())
    command.carry_out(given)
    return 0


def program() -> None:
    """The command as a process: like `main`, but an interrupted one ends at once.

    A regular exit of the interpreter would tear down threads of JAX that still compute, which sometimes crashes.
    """
    sys.excepthook = _print_bug
    try:
        main()
    except SystemExit as leaving:
        if leaving.code != 130:
            raise
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(130)


def _print_bug(kind: type[BaseException], error: BaseException, where: TracebackType | None) -> None:
    print_text("".join(traceback.format_exception(kind, error, where)), end="", error=True)
