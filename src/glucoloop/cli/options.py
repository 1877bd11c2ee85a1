"""Options of the commands, made from the keys of configurations, so that command line and files use the same settings.

Options that were not given are not passed on, so that files and defaults apply.
"""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import typer

from glucoloop.config.key import declared
from glucoloop.config.options.case import CONTROLLER_PANEL, GUARD_PANEL, CaseKeys
from glucoloop.config.options.situation import SituationKeys
from glucoloop.control.catalogue import all_settings
from glucoloop.parts.guard import GUARD, usual_text
from glucoloop.parts.number_text import in_digits, is_time, minutes_of, number_of
from glucoloop.refusal import Refusal

Given = dict[str, Any]
"""Value of each option that was given, by its key."""


_NUMBERS: Final[dict[Any, str]] = {int: "a whole number", float: "a number"}


@dataclass(frozen=True)
class Option:
    """One option of a command."""

    key: str
    flag: str
    """Name with dashes, a switch with its opposite after a slash; without dashes it is an argument, which is needed."""
    kind: Any
    help: str
    panel: str
    metavar: str | None = None
    default: str | None = None
    """Text of the default in the help."""
    empties: str | None = None
    """Key of the list that a switch makes empty."""

    @property
    def stands_for(self) -> str:
        """Key of the configuration that the option sets."""
        return self.empties or self.key

    @property
    def name(self) -> str:
        """Name of the option as the user writes it."""
        return self.flag.split("/")[0]

    def parameter(self) -> inspect.Parameter:
        """Parameter of a command's signature, from which Typer makes the option."""
        told = self.help if self.default is None else f"{self.help} (default {self.default})"
        if not self.flag.startswith("-"):
            required = typer.Argument(..., help=told, metavar=self.flag)
            return inspect.Parameter(self.key, inspect.Parameter.KEYWORD_ONLY, default=required, annotation=self.kind)
        info = typer.Option(
            None, self.flag, help=told, metavar=self.metavar, rich_help_panel=self.panel, show_default=False
        )
        # Numbers come as text: what is wrong with one is told like all other mistakes.
        kind = {int: str, float: str, list[int]: list[str], list[float]: list[str]}.get(self.kind, self.kind)
        return inspect.Parameter(self.key, inspect.Parameter.KEYWORD_ONLY, default=info, annotation=kind | None)

    def read(self, value: Any) -> Any:
        """The value in the option's type.

        Raises
        ------
        ValueError
            For a text that is not a number.
        """
        of_items = typing.get_args(self.kind)
        if of_items and of_items[0] in _NUMBERS:
            return [self._number(of_items[0], text) for text in value]
        return self._number(self.kind, value) if self.kind in _NUMBERS else value

    def _number(self, kind: Any, text: str) -> Any:
        of_time = kind is float and is_time(self.key)
        minutes = minutes_of(text) if of_time else None
        if minutes is not None:
            return minutes
        try:
            return number_of(text, kind)
        except ValueError:
            wanted = "a number of minutes, or a time with its unit like 1.5h or 2d" if of_time else _NUMBERS[kind]
            how = "" if in_digits(text) else ", in digits from 0 to 9"
            raise Refusal(f"{self.name} is {text!r}; give {wanted}{how}") from None


def options_of(record: type, **words: Mapping[str, str | None]) -> tuple[Option, ...]:
    """Options of the keys that a record declares; `words` as for `reworded`."""
    return tuple(reworded(_declared_options(record), **words))


def _declared_options(record: type) -> Iterator[Option]:
    for of in declared(record).values():
        if of.key is None:
            continue
        kind = str if of.kind is Any else list[of.kind] if of.many else of.kind  # type: ignore[name-defined]
        yield Option(of.name, of.flag, kind, of.key.summary, of.key.panel, metavar=of.metavar, default=of.told)
        if of.key.empty is not None:
            name, sentence = of.key.empty
            yield Option(name, f"--{name.replace('_', '-')}", bool, sentence, of.key.panel, empties=of.name)


def among(options: Iterable[Option], keys: Container[str]) -> tuple[Option, ...]:
    """Options that stand for some keys."""
    return tuple(option for option in options if option.stands_for in keys)


def without(options: Iterable[Option], *keys: str) -> tuple[Option, ...]:
    """Options apart from those that stand for some keys."""
    return tuple(option for option in options if option.stands_for not in keys)


def reworded(options: Iterable[Option], **words: Mapping[str, str | None]) -> Iterator[Option]:
    """Options with other texts by key, in place of some of theirs: ``help={"people": "Number of people."}``."""
    for option in options:
        texts: dict[str, Any] = {field: of[option.key] for field, of in words.items() if option.key in of}
        yield dataclasses.replace(option, **texts)


def names(options: Iterable[Option], given: Given) -> dict[str, str]:
    """Option names by key for the given options; keys of a file keep their own names."""
    return {option.key: option.name for option in options if option.key in given}


def with_options(options: Iterable[Option]) -> Callable[[Callable[[Given], None]], Callable[..., None]]:
    """Make a command from a function of the given options."""
    by_key = {option.key: option for option in options}
    parameters = [option.parameter() for option in by_key.values()]

    def decorate(function: Callable[[Given], None]) -> Callable[..., None]:
        def command(**values: Any) -> None:
            function({key: by_key[key].read(value) for key, value in values.items() if value is not None})

        command.__doc__ = function.__doc__
        command.__dict__["__signature__"] = inspect.Signature(parameters)
        command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return command

    return decorate


SETTINGS: Final = "settings"
SITUATION: Final = options_of(SituationKeys)
"""Options that all controllers of a comparison share."""


def _setting_options() -> Iterator[Option]:
    """An option for each setting of the catalogue, with the default of each controller that has it."""
    for name, owners in all_settings().items():
        first = next(iter(owners.values()))
        by_text: dict[str, list[str]] = {}
        for controller, setting in owners.items():
            by_text.setdefault(setting.default.text, []).append(controller)
        defaults = "; ".join(f"{', '.join(controllers)}: {text}" for text, controllers in by_text.items())
        yield Option(
            name,
            f"--{name.replace('_', '-')}",
            first.kind,
            f"{first.summary} One of {', '.join(first.choices)}." if first.choices else first.summary,
            CONTROLLER_PANEL,
            metavar={int: "N", float: "X", str: "NAME"}[first.kind],
            default=defaults,
        )


def _guard_options() -> Iterator[Option]:
    for setting in GUARD.values():
        flag = f"--{setting.name.replace('_', '-')}"
        yield Option(
            setting.name,
            flag,
            setting.kind,
            setting.summary,
            GUARD_PANEL,
            metavar="X",
            default=usual_text(setting.name),
        )


SETTING: Final = Option(
    SETTINGS,
    "--setting",
    list[str],
    "A setting of the controller, like gain=0.2; needed for a controller of another package, whose settings have no "
    "options of their own. Repeat it for more.",
    CONTROLLER_PANEL,
    metavar="KEY=VALUE",
)
_CASE: Final = options_of(CaseKeys)
CASE: Final = (
    *among(_CASE, ("controller",)),
    SETTING,
    *_setting_options(),
    *among(_CASE, ("known_dead_time", "guard")),
    *_guard_options(),
    *without(_CASE, "controller", "known_dead_time", "guard"),
)
"""Options of a controller, its tuning and its model."""

OUTPUT_PANEL: Final = "Files and output"
ALLOW_CODE: Final = Option(
    "allow_code",
    "--allow-code",
    bool,
    "Import the code, module:attribute, that a file or folder names; without it only what is given here is imported.",
    OUTPUT_PANEL,
)
"""Option that the program reads itself, before the command."""
OUTPUT: Final = (
    Option(
        "config",
        "--config",
        str,
        "Read options from a TOML file; those given here win, and a list given here takes the place of the file's.",
        OUTPUT_PANEL,
        metavar="FILE",
    ),
    ALLOW_CODE,
    Option("out", "--out", str, "Folder for tables, figures and the configuration.", OUTPUT_PANEL, metavar="DIR"),
    Option("overwrite", "--overwrite", bool, "Replace an earlier result in that folder.", OUTPUT_PANEL),
    Option("json", "--json", bool, "Print one JSON object instead of a table.", OUTPUT_PANEL),
)
MMOL: Final = Option("mmol", "--mmol", bool, "Show glucose in mmol/l as well.", OUTPUT_PANEL)
