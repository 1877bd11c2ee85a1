"""Settings of a part: name, type, meaning and usual value.

Nothing in this package imports a numerical library, so that help is shown at once.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import functools
import math
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeVar, dataclass_transform

from glucoloop.plausible import Quantity
from glucoloop.refusal import Refusal

Value = int | float | str

MOST_NAMES_TOLD: Final = 12
AMONG_OPTIONS: Final = "--help of the command has each as an option"
"""Text on where all keys of a configuration are told."""
_SHORTEST_WORD: Final = 4
"""Length from which a part of a name says what it is about; shorter ones are mostly units."""


@dataclass(frozen=True)
class Default:
    """Value of a setting that was not given; it may depend on whether readings are noisy."""

    noise_free: Value
    noisy: Value | None = None
    """Value with noisy readings, or None for the same as without noise."""

    def value(self, *, noisy: bool) -> Value:
        """Value for a run with or without noise."""
        return self.noisy if noisy and self.noisy is not None else self.noise_free

    @property
    def text(self) -> str:
        """Text for help: ``8`` or ``8, with noise 10``."""
        noisy = "" if self.noisy in (None, self.noise_free) else f", with noise {_told(self.noisy)}"
        return f"{_told(self.noise_free)}{noisy}"


Tunings = Mapping[str, Mapping[str, Default]]
"""Usual values of settings for a patient, by controller and setting, where they differ from the controller's own."""


def _told(value: Value | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Setting:
    """One setting of a part.

    The same name may stand in several entries, each with its default, but always with one type.
    """

    name: str
    """Name in a configuration file; the option is the same with dashes."""
    type: type[int] | type[float] | type[str] | type[bool]
    summary: str
    """Description, with the paper's symbol if it has one."""
    default: Default
    choices: tuple[str, ...] = ()
    quantity: Quantity | None = None
    """Quantity with its plausible range, or None if all values of the type are plausible."""

    def check(self, value: object) -> Value:
        """Value converted to the setting's type; its bounds are checked by the design.

        Raises
        ------
        ValueError
            For a value of another type, or one that is not among the choices.
        """
        if self.choices and value not in self.choices:
            raise Refusal(f"{self.name} is {value!r}; the known ones are: {', '.join(self.choices)}")
        if isinstance(value, bool):
            if self.type is bool:
                return value
        elif self.type is float and isinstance(value, int | float):
            with contextlib.suppress(OverflowError):  # of a whole number beyond all floats
                return float(value)
        elif isinstance(value, self.type):
            return value
        kinds: dict[type, str] = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
        raise Refusal(f"{self.name} is {value!r}; give {kinds[self.type]}")


@dataclass(frozen=True)
class About:
    """Meaning of a setting and its possible values: the annotation of a field of a `settings_record`."""

    summary: str
    """Sentence on the setting, with the unit and the symbol of the paper."""
    at_least: float = -math.inf
    at_most: float = math.inf
    above: float = -math.inf
    below: float = math.inf
    quantity: Quantity | None = None
    called: str = ""
    """Name of the value in messages; by default the name of the setting."""
    finite: bool = True
    """Whether a number has to be finite."""

    def allows(self, value: float) -> bool:
        """Whether a number is finite, where it has to be, and within the bounds."""
        if not self.finite and not math.isfinite(value):
            return True
        return self.at_least <= value <= self.at_most and self.above < value < self.below

    def possible(self, kind: type) -> str:
        """Possible numbers in words, for an error about another one."""
        if math.isfinite(self.below):
            return f"{self.at_least:g} or more and less than {self.below:g}"
        if kind is int and self.at_most - self.at_least == 1:
            return f"{self.at_least:g} or {self.at_most:g}"
        if math.isfinite(self.at_most) and math.isfinite(self.above):
            return f"a value above {self.above:g} and up to {self.at_most:g}"
        if math.isfinite(self.at_most):
            return f"{'a whole number from ' if kind is int else ''}{self.at_least:g} to {self.at_most:g}"
        if kind is int:
            return f"a whole number of {self.at_least:g} or more"
        if math.isfinite(self.above):
            return f"a finite value above {self.above:g}"
        return f"a finite value of {self.at_least:g} or more" if math.isfinite(self.at_least) else "a finite value"


Record = TypeVar("Record")
_UNITS: Final = {
    "mg_dl_h": " mg/dl per hour",
    "_mg_dl_U": " mg/dl per U",
    "_mg_dl_min": " mg/dl per min",
    "_mg_dl": " mg/dl",
    "_mU_min": " mU/min",
    "_mg_min": " mg/min",
    "_g_U": " g/U",
    "_per_h": " per hour",
    "_per_day": " per day",
    "_min": " min",
    "_g": " g",
}
"""Unit of a value in words, by the end of its setting's name."""
_MOST: Final = 1e30
_SHORTEST_OF_WORDS: Final = 3
"""Least length of each part of a name that is told in words; others hold units that are not known here."""


def usual(*, default: Any, noisy: Any) -> Any:
    """Default of a field of a record, which may differ with noisy readings."""
    return dataclasses.field(default=default, metadata={"noisy": noisy})


@dataclass_transform(frozen_default=True, field_specifiers=(usual,))
def settings_record(cls: type[Record]) -> type[Record]:
    """Make a frozen dataclass of a class whose fields are annotated settings, and check its values.

    Each field is a setting, with a default: ``filter_min: Annotated[float, About("Lag, in minutes.", above=0)] = 1.0``.
    A ``Literal`` lists the choices. An argument of another type, out of its bounds or not among the choices raises
    ValueError. The option, the key of files, the help and the documentation of a setting follow from its field.
    """
    own_check = getattr(cls, "__post_init__", None)

    def check(self: Any) -> None:
        if type(self) is made:  # once, and not by each class that this one extends
            _check_bounds(self)
        if own_check is not None:
            own_check(self)

    cls.__post_init__ = check  # type: ignore[attr-defined]
    made: Any = dataclass(frozen=True)(cls)
    made.__doc__ = f"{cls.__doc__}\n\n    Parameters\n    ----------\n" + "".join(
        f"    {setting.name} : {setting.type.__name__}\n        {setting.summary}\n" for setting in settings_of(made)
    )
    plain = made.__init__

    @functools.wraps(plain)
    def first_init(self: Any, *args: Any, **kwargs: Any) -> None:
        # `arguments` imports JAX, which the help of the command line does without
        from glucoloop.arguments import checked

        made.__init__ = plain
        checked(made)
        made.__init__(self, *args, **kwargs)

    made.__init__ = first_init
    return typing.cast(type[Record], made)


def declarations(record: type) -> dict[str, tuple[Any, About]]:
    """Type and meaning of each field of a record."""
    hints = typing.get_type_hints(record, include_extras=True)
    declared = {}
    for field in dataclasses.fields(record):
        hint = hints[field.name]
        about = next((part for part in getattr(hint, "__metadata__", ()) if isinstance(part, About)), None)
        if about is None:
            raise Refusal(
                f"the setting {field.name} of {record.__name__} does not say what it means; annotate it, like "
                f'{field.name}: Annotated[float, About("Gain, in mU/min per mg/dl.")] = 1.0'
            )
        declared[field.name] = (hint.__origin__, about)
    return declared


@functools.cache
def settings_of(record: type) -> tuple[Setting, ...]:
    """The settings that the fields of a `settings_record` declare.

    Raises
    ------
    ValueError
        For a field without a description or without a default.
    """
    declared, settings = declarations(record), []
    for field in dataclasses.fields(record):
        if field.default is dataclasses.MISSING:
            raise Refusal(f"the setting {field.name} of {record.__name__} has no default; give it one")
        kind, about = declared[field.name]
        choices = typing.get_args(kind) if typing.get_origin(kind) is Literal else ()
        default = Default(field.default, field.metadata.get("noisy"))
        kind = type(choices[0]) if choices else kind
        settings.append(Setting(field.name, kind, about.summary, default, choices=choices, quantity=about.quantity))
    return tuple(settings)


def _check_bounds(record: Any) -> None:
    from glucoloop.arguments import is_traced

    for name, (kind, about) in declarations(type(record)).items():
        value = getattr(record, name)
        if typing.get_origin(kind) is Literal:
            if value not in typing.get_args(kind):
                raise Refusal(f"{name} is {value!r}; the known ones are: {', '.join(typing.get_args(kind))}")
        elif kind in (int, float) and not is_traced(value):
            mend = (
                about.possible(kind)
                if not about.allows(value)
                else f"a number of a size up to {_MOST:g}"
                if about.finite and abs(value) > _MOST
                else ""
            )
            if mend:
                ending, unit = next(((end, unit) for end, unit in _UNITS.items() if name.endswith(end)), ("", ""))
                raise Refusal(f"{_named(name, ending, about, f'{value:g}{unit}')} not possible; give {mend}")


def _named(name: str, ending: str, about: About, value: str) -> str:
    """A setting and its value, to the verb of a sentence: ``a move weight of -1 is``."""
    parts = name.removesuffix(ending).strip("_").split("_")
    if not about.called and any(len(part) < _SHORTEST_OF_WORDS for part in parts):
        return f"{name} of {value} is"
    words = about.called or " ".join(parts)
    if words.endswith("s") and not about.called:
        return f"{words} of {value} are"
    return f"{'an' if words[0] in 'aeiou' else 'a'} {words} of {value} is"


def refuse_unknown_keys(keys: Iterable[str], known: Iterable[str], of: str = "") -> None:
    """Raise ValueError for the first key that is not known; ``of`` says of what: ``" of a trial"``."""
    names = list(known)
    for key in keys:
        if key not in names:
            told = known_names(key, names, where=AMONG_OPTIONS)
            raise Refusal(f"unknown key {key!r}{of}; {told}")


def known_names(unknown: str, known: Iterable[str], *, where: str = "") -> str:
    """Text about known names after an unknown one: the most similar one, and the others unless they are many.

    Where they are many and `where` says where all stand, those that share a word with the unknown one are told.
    """
    names = list(known)
    if not names:
        return "there are none"
    close = difflib.get_close_matches(unknown, names, n=1)
    if close and len(names) > MOST_NAMES_TOLD:
        return f"did you mean {close[0]!r}?"
    if where and len(names) > MOST_NAMES_TOLD:
        words = {word for word in unknown.casefold().split("_") if len(word) >= _SHORTEST_WORD}
        alike = [name for name in names if words & set(name.casefold().split("_"))]
        if len(alike) == 1:
            return f"did you mean {alike[0]!r}?"
        if 1 < len(alike) <= MOST_NAMES_TOLD:
            return f"those like it are: {', '.join(alike)}"
        return f"none of the {len(names)} known ones is like it; {where}"
    meant = f"did you mean {close[0]!r}? " if close else ""
    return f"{meant}the known ones are: {', '.join(names)}"
