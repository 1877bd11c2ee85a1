"""A command: options made from settings, argparse with refusals in a sentence, and a help of one line an option."""

from __future__ import annotations

import argparse
import dataclasses
import difflib
import functools
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NoReturn

from glucoloop.cli.screen import width_of_text
from glucoloop.component.base import Component
from glucoloop.component.request import Request, request_of
from glucoloop.component.setting import OUTPUT_PANEL, PANELS, WORK_PANEL, Option, Setting, value_text
from glucoloop.refusal import Refusal

Given = dict[str, Any]
"""Text of each option that was given, by its key: True for a switch, a list where it may be repeated."""
_METAVARS: Final = {"mg/dl": "MG/DL", "mU/min": "MU/MIN", "min": "MIN", "%": "PCT", "U": "U"}


@dataclass(frozen=True)
class CommandOption:
    """One option of a command, or one of its arguments."""

    key: str
    flag: str
    """Name with dashes; without dashes it is an argument."""
    help: str
    panel: str = OUTPUT_PANEL
    metavar: str | None = None
    """Placeholder of the value; None for a switch."""
    many: bool = False
    default: str = ""
    rare: bool = False
    alone: str = ""
    """Text for which it stands without a value, where it may."""
    required: bool = True
    """Whether an argument is needed."""
    setting: Setting | None = None
    """Setting that it gives."""

    @property
    def is_argument(self) -> bool:
        """Whether it is an argument."""
        return not self.flag.startswith("-")

    @property
    def placeholder(self) -> str:
        """Place of the value in the help, after a blank; empty for a switch and for an argument."""
        if self.metavar is None or self.is_argument:
            return ""
        return f" [{self.metavar}]" if self.alone else f" {self.metavar}"

    @property
    def text(self) -> str:
        """Sentence of the help, with the default."""
        return f"{self.help} Default: {self.default}." if self.default else self.help


def options_of(root: type[Component]) -> tuple[CommandOption, ...]:
    """Options of the settings of a class that are declared as such and not refused; with a sensor, the short ones."""
    options = [
        CommandOption(
            key=setting.name,
            flag=about.flag or flag_of(setting.name, setting.unit),
            help=about.summary,
            panel=about.panel,
            metavar=None if setting.kind is bool else about.metavar or _metavar(setting),
            many=setting.many,
            default=_default_text(setting) or about.default,
            rare=about.rare,
            alone=about.alone,
            setting=setting,
        )
        for setting in root.settings().values()
        if isinstance(about := setting.about, Option) and setting.name not in root.refused
    ]
    return (*options, *(SHORT if any(option.key == "sensor" for option in options) else ()))


def flag_of(name: str, unit: str) -> str:
    """Name of the option of a setting: without its unit."""
    ending = f"_{unit.replace('/', '_').replace('%', 'pct')}" if unit in _METAVARS else ""
    return f"--{(name.removesuffix(ending) if ending else name).replace('_', '-')}"


def _metavar(setting: Setting) -> str:
    if setting.is_component:
        return "COMPONENT"
    return (
        "|".join(map(str, setting.choices))
        or _METAVARS.get(setting.unit)
        or {int: "N", float: "X"}.get(setting.kind, "NAME")
    )


def _default_text(setting: Setting) -> str:
    """The default in words; empty where it goes without saying: none, off, or an empty list."""
    default = setting.default.noise_free
    if default is None or isinstance(default, bool | Request) or default == ():
        return ""
    if isinstance(default, tuple) and isinstance(default[0], Component | Request):
        return ", ".join(request_of(component).text for component in default)
    return ", ".join(map(value_text, default)) if setting.many else value_text(default)


def reworded(options: Iterable[CommandOption], **by_field: Mapping[str, Any]) -> Iterator[CommandOption]:
    """Options with other texts by key, in place of some of theirs: ``help={"people": "Number of people."}``."""
    for option in options:
        texts: dict[str, Any] = {
            field: by_key[option.key] for field, by_key in by_field.items() if option.key in by_key
        }
        yield dataclasses.replace(option, **texts)


CONFIG: Final = CommandOption(
    "config", "--config", "Read a TOML file; what is given here is laid over it.", metavar="FILE"
)
SET: Final = CommandOption(
    "set",
    "--set",
    "A setting by its path, like patient.operating_point=fasting-81; repeat it.",
    metavar="PATH=VALUE",
    many=True,
)
ALLOW_CODE: Final = CommandOption(
    "allow_code",
    "--allow-code",
    "Import the code, module:attribute, that a file or folder names; without it only what is given here is imported.",
    rare=True,
)
"""Option that the program reads itself, before the command."""
OUT: Final = CommandOption("out", "--out", "Folder for tables, figures and the configuration.", metavar="DIR")
OVERWRITE: Final = CommandOption("overwrite", "--overwrite", "Replace an earlier result in that folder.")
JSON: Final = CommandOption("json", "--json", "Print one JSON object instead of a table.")
UNITS: Final = CommandOption(
    "units",
    "--units",
    "Show results in mmol/l, U/h or both; data files keep mg/dl and mU/min.",
    metavar="UNIT,UNIT",
)
OVERWRITE_FILE: Final = CommandOption("overwrite", "--overwrite", "Replace a file of that name.")
"""Option of a command whose result is one file."""
OUTPUT: Final = (CONFIG, SET, ALLOW_CODE, OUT, OVERWRITE, JSON)
WORKERS: Final = CommandOption(
    "workers",
    "--workers",
    "Threads that compute; with --dask local, processes.",
    panel=WORK_PANEL,
    metavar="N",
    default="one a core",
)
DASK: Final = CommandOption(
    "dask",
    "--dask",
    "Compute on a Dask cluster: the address of its scheduler, like tcp://10.0.0.1:8786, its file, which ends in .json, "
    "or local.",
    panel=WORK_PANEL,
    metavar="ADDRESS",
)
TRACES_AT: Final = CommandOption(
    "traces_at",
    "--traces-at",
    "Store of objects for the traces of --traces, in place of the folder, like s3://bucket/folder; each worker writes "
    "its own.",
    panel=WORK_PANEL,
    metavar="ADDRESS",
    rare=True,
)
NOISE: Final = CommandOption(
    "noise",
    "--noise",
    "Variance of white noise on each reading, (mg/dl)²; the paper's is 1.45. Short for a component of --sensor.",
    panel="Sensor and pump",
    metavar="VARIANCE",
)
DEAD_TIME: Final = CommandOption(
    "dead_time",
    "--dead-time",
    "Delay of the readings in whole samples. Short for a component of --sensor.",
    panel="Sensor and pump",
    metavar="MIN",
)
SHORT: Final = (NOISE, DEAD_TIME)
"""Options that stand for a component of the sensor."""


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
            misspelt, near = (difflib.get_close_matches(word, self._by_flag, n=1, cutoff=part) for part in (0.9, 0.6))
            meant = "" if misspelt else self._other_way(word)
            advice = meant or (f"did you mean {near[0]}?" if near else see)
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
        longer = [flag for flag in self._by_flag if flag.startswith(f"{word}-")]
        if len(longer) == 1:
            return f"did you mean {longer[0]}?"
        if word.startswith("--no-") and switch is not None and switch.metavar is not None:
            return f"write {switch.flag} none"
        for kind, catalogue in catalogues().items():
            for name, component in catalogue.items() if f"--{kind}" in self._by_flag else ():
                for setting in component.settings().values():
                    flag = flag_of(setting.name, setting.unit)
                    if word in (flag, f"--{setting.name}".replace("_", "-"), f"--{kind}-{flag[2:]}"):
                        return f"write --{kind} '{'' if catalogue.unnamed else f'{name}, '}{setting.name}=...'"
        return ""
