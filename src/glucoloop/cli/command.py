"""A command: argparse with refusals in a sentence, and a help of one line an option."""

from __future__ import annotations

import argparse
import difflib
import functools
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NoReturn

from glucoloop.cli.option import CommandOption, Given, flag_of
from glucoloop.cli.screen import width_of_text
from glucoloop.refusal import Refusal
from glucoloop.situations.option import PANELS

_INDENT: Final = 24


@dataclass(frozen=True)
class Command:
    """One command of the program."""

    name: str
    intro: str
    """Paragraphs of the help; those that begin with two spaces are examples."""
    options: tuple[CommandOption, ...]
    carry_out: Callable[[Given], None]
    more: str = ""
    """Name with which `glucoloop list` describes the options that the help only names."""

    def given(self, arguments: Sequence[str]) -> Given:
        """The options that were given, by key; Refusal for an unknown one, one without a value, or one given twice."""
        results = vars(_Parser(f"glucoloop {self.name}", self.options).parse_args(arguments))
        return {key: value for key, value in results.items() if value is not None}

    def help(self) -> str:
        """Help: what the command does, its options by heading, and the names of those that are seldom needed."""
        wrapped = functools.partial(textwrap.wrap, break_on_hyphens=False, break_long_words=False)
        width = width_of_text()
        arguments = [option for option in self.options if option.is_argument]
        names = [option.flag if option.required else f"[{option.flag}]" for option in arguments]
        lines = [" ".join(["Usage: glucoloop", self.name, *names, "[OPTIONS]"]), ""]
        examples: list[str] = []
        for paragraph in self.intro.split("\n\n"):
            if paragraph.startswith("  "):
                examples += wrapped(paragraph.strip(), width - 2, initial_indent="  ", subsequent_indent="      ")
            else:
                lines += [*wrapped(paragraph, width), ""]
        lines += [*examples, ""] if examples else []

        sections: dict[str, list[CommandOption]] = {"Arguments": arguments} if arguments else {}
        for option in self.options:
            if not option.rare and not option.is_argument:
                sections.setdefault(option.panel, []).append(option)
        for heading in sorted(sections, key=lambda name: PANELS.index(name) if name in PANELS else -1):
            lines.append(f"{heading}:")
            for option in sections[heading]:
                head, indent = f"  {option.flag}{option.placeholder}", " " * _INDENT
                if len(head) < _INDENT - 1:
                    lines += wrapped(f"{head:<{_INDENT}}{option.text}", width, subsequent_indent=indent)
                else:
                    lines += [head, *wrapped(option.text, width, initial_indent=indent, subsequent_indent=indent)]
            lines.append("")
        rare = [option.flag for option in self.options if option.rare]
        if rare:
            where = f" (glucoloop list {self.more} describes them)" if self.more else ""
            lines += wrapped(f"Further options{where}: {', '.join(rare)}.", width)
        return "\n".join(lines).rstrip() + "\n"


class _Once(argparse.Action):
    """Value of an option that is given once; of a switch, whether it is on."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        if getattr(namespace, self.dest) is not None:
            off = self.nargs == 0 and self.const is False
            twice = "and its opposite exclude one another" if off else "is given twice"
            raise Refusal(f"{option_string} {twice}; leave one out")
        setattr(namespace, self.dest, self.const if self.nargs == 0 else values)


class _Parser(argparse.ArgumentParser):
    def __init__(self, prog: str, options: Sequence[CommandOption]) -> None:
        super().__init__(prog=prog, add_help=False, allow_abbrev=False)
        self._negative_number_matcher = re.compile(r"-[0-9.]")  # of all numbers, also -1e3 and -.5h
        self._by_flag = {option.flag: option for option in options}
        for option in options:
            if option.is_argument:
                nargs = ("+" if option.required else "*") if option.many else None if option.required else "?"
                self.add_argument(option.key, nargs=nargs, metavar=option.flag)
            elif option.metavar is None:
                self.add_argument(option.flag, dest=option.key, action=_Once, nargs=0, const=True)
                if option.setting is not None:
                    off = f"--no-{option.flag.removeprefix('--')}"
                    self.add_argument(off, dest=option.key, action=_Once, nargs=0, const=False)
            else:
                more: dict[str, Any] = {"nargs": "?", "const": option.alone} if option.alone else {}
                action: Any = "append" if option.many else _Once
                self.add_argument(option.flag, dest=option.key, metavar=option.metavar, action=action, **more)

    def error(self, message: str) -> NoReturn:
        """Refuse what argparse refuses, in a sentence."""
        see = f"see {self.prog} --help"
        unknown = re.match(r"unrecognized arguments: (\S+)", message)
        if unknown is not None:
            word = unknown[1].partition("=")[0]
            if not word.startswith("-"):
                raise Refusal(f"{self.prog} takes no argument {word!r}; {see}")
            near = difflib.get_close_matches(word, self._by_flag, n=1)
            advice = self._other_way(word) or (f"did you mean {near[0]}?" if near else see)
            raise Refusal(f"there is no option {word}; {advice}")
        lacking = re.match(r"argument (\S+?)(?:/\S+)?: expected one argument", message)
        if lacking is not None:
            raise Refusal(f"{lacking[1]} has no value; give one after it")
        missing = re.match(r"the following arguments are required: (.*)", message)
        raise Refusal(f"{missing[1]} is missing; {see}" if missing is not None else f"{message}; {see}")

    def _other_way(self, word: str) -> str:
        """Advice for an option that is none: a component to leave out, or a setting of one; empty for others."""
        from glucoloop.component.catalogue import catalogues

        switch = self._by_flag.get(word.replace("--no-", "--", 1))
        if word.startswith("--no-") and switch is not None and switch.metavar is not None:
            return f"write {switch.flag} none"
        for kind, catalogue in catalogues().items():
            for name, component in catalogue.items() if f"--{kind}" in self._by_flag else ():
                for setting in component.settings().values():
                    flag = flag_of(setting.name, setting.unit)
                    if word in (flag, f"--{setting.name}".replace("_", "-"), f"--{kind}-{flag[2:]}"):
                        return f"write --{kind} '{'' if catalogue.unnamed else f'{name}, '}{setting.name}=...'"
        return ""
