"""The command line: argparse with a help of one line an option, and refusals in a sentence."""

from __future__ import annotations

import argparse
import difflib
import re
import shutil
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any, Final, NoReturn

from glucoloop.cli.option import CommandOption, Given, flag_of
from glucoloop.refusal import Refusal
from glucoloop.situations.option import PANELS

_WIDEST: Final = 100
_INDENT: Final = 24
_NUMBER: Final = re.compile(r"-[0-9.]")


class _Once(argparse.Action):
    """Value of an option that is given once."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        if getattr(namespace, self.dest) is not None:
            raise Refusal(f"{option_string} is given twice; leave one out")
        setattr(namespace, self.dest, True if self.nargs == 0 else values)


class Parser(argparse.ArgumentParser):
    """Parser of one command.

    Parameters
    ----------
    prog : str
        The command as it is typed.
    intro : str
        Paragraphs of its help; those that begin with two spaces are examples.
    options : iterable of CommandOption
    more : str
        Part by whose name `glucoloop list` describes the options that the help only names.
    """

    def __init__(self, prog: str, intro: str, options: Iterable[CommandOption], more: str = "") -> None:
        super().__init__(prog=prog, add_help=False, allow_abbrev=False)
        self._intro, self._options, self._more = intro, tuple(options), more
        for option in self._options:
            self._add(option)

    def _add(self, option: CommandOption) -> None:
        if not option.flag.startswith("-"):
            self.add_argument(option.key, nargs=None if option.required else "?", metavar=option.flag)
            return
        if option.metavar is None:
            self.add_argument(option.flag, dest=option.key, action=_Once, nargs=0)
            if option.setting is not None:
                self.add_argument(f"--no-{option.flag.removeprefix('--')}", dest=option.key, action=_No, nargs=0)
            return
        more: dict[str, Any] = {"action": "append"} if option.many else {"action": _Once}
        if option.alone:
            more |= {"nargs": "?", "const": option.alone}
        self.add_argument(option.flag, dest=option.key, metavar=option.metavar, **more)

    def given(self, arguments: Sequence[str]) -> Given:
        """The options that were given, by key.

        Raises
        ------
        Refusal
            For an unknown option, one without its value, or one that is given twice.
        """
        found = vars(self.parse_args(self._joined(arguments)))
        return {key: value for key, value in found.items() if value is not None}

    def _joined(self, arguments: Sequence[str]) -> list[str]:
        """Arguments in which a value that begins with a minus belongs to its option."""
        takes = {option.flag for option in self._options if option.metavar is not None}
        joined: list[str] = []
        for argument in arguments:
            if joined and joined[-1] in takes and _NUMBER.match(argument):
                joined[-1] = f"{joined[-1]}={argument}"
            else:
                joined.append(argument)
        return joined

    def error(self, message: str) -> NoReturn:
        """Refuse what argparse refuses, in a sentence."""
        see = f"see {self.prog} --help"
        unknown = re.match(r"unrecognized arguments: (\S+)", message)
        if unknown is not None:
            word = unknown[1].partition("=")[0]
            if not word.startswith("-"):
                raise Refusal(f"{self.prog} takes no argument {word!r}; {see}")
            near = difflib.get_close_matches(word, [option.flag for option in self._options], n=1)
            advice = self._put_otherwise(word) or (f"did you mean {near[0]}?" if near else see)
            raise Refusal(f"there is no option {word}; {advice}")
        lacking = re.match(r"argument (\S+?)(?:/\S+)?: expected one argument", message)
        if lacking is not None:
            raise Refusal(f"{lacking[1]} has no value; give one after it")
        missing = re.match(r"the following arguments are required: (.*)", message)
        if missing is not None:
            raise Refusal(f"{missing[1]} is missing; {see}")
        raise Refusal(f"{message}; {see}")

    def _put_otherwise(self, word: str) -> str:
        """Words in place of an option that is none: a part that is left out, or a setting of a part."""
        from glucoloop.parts.catalogue import catalogues

        flags = {option.flag: option for option in self._options}
        off = word.replace("--no-", "--", 1)
        if off != word and off in flags and flags[off].metavar is not None:
            return f"write {off} none"
        for kind, catalogue in catalogues().items():
            for name, part in catalogue.items() if f"--{kind}" in flags else ():
                for setting in part.settings().values():
                    flag = flag_of(setting.name, setting.unit)
                    if word in (flag, f"--{setting.name}".replace("_", "-"), f"--{kind}-{flag[2:]}"):
                        return f"write --{kind} '{'' if catalogue.unnamed else f'{name}, '}{setting.name}=...'"
        return ""

    def format_help(self) -> str:
        """Help of a command: what it does, its options by heading, and the names of those that are seldom needed."""
        width = min(_WIDEST, shutil.get_terminal_size((_WIDEST, 24)).columns)
        arguments = [option for option in self._options if not option.flag.startswith("-")]
        called = " ".join(option.flag if option.required else f"[{option.flag}]" for option in arguments)
        lines = [f"Usage: {' '.join(filter(None, (self.prog, called, '[OPTIONS]')))}", ""]
        examples: list[str] = []
        for paragraph in self._intro.split("\n\n"):
            if paragraph.startswith("  "):
                examples += textwrap.wrap(
                    paragraph.strip(), width - 2, initial_indent="  ", subsequent_indent="      ", **_WRAP
                )
            else:
                lines += [*textwrap.wrap(paragraph, width, **_WRAP), ""]
        lines += [*examples, ""] if examples else []
        shown = [option for option in self._options if not option.rare]
        panels = dict.fromkeys(option.panel for option in shown if option.flag.startswith("-"))
        further = [panel for panel in panels if panel not in PANELS]
        if arguments:
            lines += ["Arguments:", *(line for option in arguments for line in _lines(option, width)), ""]
        for panel in (*further, *(panel for panel in PANELS if panel in panels)):
            lines.append(f"{panel}:")
            for option in shown:
                if option.panel == panel and option.flag.startswith("-"):
                    lines += _lines(option, width)
            lines.append("")
        rare = [option.flag for option in self._options if option.rare]
        if rare:
            where = f" (glucoloop list {self._more} describes them)" if self._more else ""
            lines += textwrap.wrap(f"Further options{where}: {', '.join(rare)}.", width, **_WRAP)
        return "\n".join(lines).rstrip() + "\n"


class _No(argparse.Action):
    """Switch that turns another one off."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        if getattr(namespace, self.dest) is not None:
            raise Refusal(f"{option_string} and its opposite exclude one another; leave one out")
        setattr(namespace, self.dest, False)


_WRAP: Final[dict[str, Any]] = {"break_on_hyphens": False, "break_long_words": False}


def _lines(option: CommandOption, width: int) -> list[str]:
    """Lines of the help on an option."""
    value = f" [{option.metavar}]" if option.alone else f" {option.metavar}" if option.metavar else ""
    head = f"  {option.flag}{value}" if option.flag.startswith("-") else f"  {option.flag}"
    text = option.text
    if len(head) < _INDENT - 1:
        return textwrap.wrap(f"{head:<{_INDENT}}{text}", width, subsequent_indent=" " * _INDENT, **_WRAP)
    return [
        head,
        *textwrap.wrap(text, width, initial_indent=" " * _INDENT, subsequent_indent=" " * _INDENT, **_WRAP),
    ]
