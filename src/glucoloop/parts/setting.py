"""A setting of a part: its meaning, bounds and unit, the check of a value, and the reading of one from text.

Nothing here imports a numerical library, so that help and refusals come at once.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from glucoloop.plausible import CONFIRM_OPTION, Quantity, doubt
from glucoloop.refusal import Refusal
from glucoloop.units import HOURS_PER_DAY, MG_DL_PER_MMOL_L, MIN_PER_H, MU_PER_U, S_PER_MIN

Value = int | float | str | bool

_UNITS: Final = {
    "_mg_dl_h": "mg/dl per hour",
    "_mg_dl_min": "mg/dl per min",
    "_mg_dl_U": "mg/dl per U",
    "_mg_min": "mg/min",
    "_g_U": "g per U",
    "_mg_dl": "mg/dl",
    "_mU_min": "mU/min",
    "_min": "min",
    "_pct": "%",
    "_U": "U",
    "_g": "g",
}
"""Unit of a value by the end of its name."""

OTHER_UNITS: Final[dict[str, dict[str, float]]] = {
    "mg/dl": {"mmol/l": MG_DL_PER_MMOL_L},
    "mU/min": {"U/h": MU_PER_U / MIN_PER_H, "mU/h": 1.0 / MIN_PER_H},
    "min": {"m": 1.0, "h": MIN_PER_H, "s": 1.0 / S_PER_MIN, "d": HOURS_PER_DAY * MIN_PER_H},
    "g": {"mg": 1e-3},
    "U": {"mU": 1.0 / MU_PER_U},
}
"""Other units in which a value may be typed, by the setting's own, and their factors to it."""

_NUMBER: Final = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?(?:inf|nan)")
_WITH_UNIT: Final = re.compile(rf"({_NUMBER.pattern})\s*([A-Za-zµ²()/%]+)")
LARGEST: Final = 1e30
"""Largest size of a number, so that no product of a few of them overflows."""
_LONGEST: Final = 60
MOST_NAMES_TOLD: Final = 12
AMONG_SETTINGS: Final = "--help of the command has each, and glucoloop list"
"""Text on where all settings are told."""
_SHORTEST_WORD: Final = 4
"""Length from which a part of a name says what it is about; shorter ones are mostly units."""


@dataclass(frozen=True)
class About:
    """Meaning of a setting and its possible values: the annotation of a field of a `part.Part`.

    The bounds of a list are those of its items.
    """

    summary: str
    """Sentence on the setting, with the symbol of the paper if it has one."""
    at_least: float = -math.inf
    at_most: float = math.inf
    above: float = -math.inf
    below: float = math.inf
    unit: str = ""
    """Unit; by default that of the quantity, or the one at the end of the name."""
    quantity: Quantity | None = None
    """Quantity with its plausible range, or None if all values within the bounds are plausible."""
    finite: bool = True
    """Whether a number has to be finite."""
    reads: Callable[[Any], Any] | None = None
    """Function that reads a value where any type may be possible; it raises a Refusal that says what to give."""

    def allows(self, value: float) -> bool:
        """Whether a number is finite, where it has to be, and within the bounds."""
        if not self.finite:
            return math.isnan(value) or self.at_least <= value <= self.at_most
        return abs(value) <= LARGEST and self.at_least <= value <= self.at_most and self.above < value < self.below

    def possible(self, kind: type, unit: str = "") -> str:
        """Possible numbers in words."""
        endless = self.finite and kind is float and self.at_most == self.below == math.inf
        what = "a whole number" if kind is int else "a finite number" if endless else "a number"
        unit = f" {unit}" if unit else ""
        if self.at_least > -math.inf and self.at_most < math.inf:
            return f"{what} from {_bound(self.at_least)} to {_bound(self.at_most)}{unit}"
        bounds = [
            f"of {_bound(self.at_least)}{unit} or more" if self.at_least > -math.inf else "",
            f"above {_bound(self.above)}{unit}" if self.above > -math.inf else "",
            f"up to {_bound(self.at_most)}{unit}" if self.at_most < math.inf else "",
            f"below {_bound(self.below)}{unit}" if self.below < math.inf else "",
        ]
        words = " and ".join(filter(None, bounds))
        return f"{what} {words}" if words else f"{what}{unit}"


@dataclass(frozen=True)
class Default:
    """Value of a setting that was not given; it may depend on whether readings are noisy."""

    noise_free: Any
    noisy: Any = None
    """Value with noisy readings, or None for the same as without noise."""

    def value(self, *, noisy: bool) -> Any:
        """Value for a run with or without noise."""
        return self.noisy if noisy and self.noisy is not None else self.noise_free

    @property
    def text(self) -> str:
        """Text for help: ``8`` or ``8, with noise 10``."""
        noisy = "" if self.noisy in (None, self.noise_free) else f", with noise {value_text(self.noisy)}"
        return f"{value_text(self.noise_free)}{noisy}"


Tunings = Mapping[str, Mapping[str, Default]]
"""Usual values of settings for a patient, by controller and setting, where they differ from the controller's own."""


def usual(*, default: Any, noisy: Any) -> Any:
    """Default of a field of a part, which may differ with noisy readings."""
    return dataclasses.field(default=default, metadata={"noisy": noisy})


def value_text(value: Any) -> str:
    """A value as it is written."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Setting:
    """A declared setting of a part."""

    name: str
    kind: Any
    """Type without None; of a list the type of its items, and str for one of several choices."""
    choices: tuple[Any, ...]
    optional: bool
    many: bool
    default: Default
    about: About

    @property
    def summary(self) -> str:
        """Sentence on the setting."""
        return self.about.summary

    @property
    def quantity(self) -> Quantity | None:
        """Quantity with its plausible range, if it has one."""
        return self.about.quantity

    @property
    def unit(self) -> str:
        """Unit of a number."""
        own = self.about.unit or (self.about.quantity.unit if self.about.quantity is not None else "")
        return own or next((unit for ending, unit in _UNITS.items() if self.name.endswith(ending)), "")

    @property
    def is_part(self) -> bool:
        """Whether its values are parts, which have a catalogue."""
        return isinstance(self.kind, type) and hasattr(self.kind, "catalogue")

    def renamed(self, name: str) -> Setting:
        """The same setting under the name of its option, in the same unit."""
        return dataclasses.replace(self, name=name, about=dataclasses.replace(self.about, unit=self.unit))

    def read(self, text: str) -> object:
        """Value of a text in the type of the setting; the text itself where it is none, which `check` refuses."""
        text = text.strip()
        if self.kind is bool:
            return {"true": True, "false": False}.get(text, text)
        if self.kind is int:
            return int(text) if re.fullmatch(r"[-+]?[0-9]+", text) else text
        if self.kind is not float:
            return text
        if _NUMBER.fullmatch(text):
            return float(text)
        found = _WITH_UNIT.fullmatch(text)
        if found is None:
            return text
        factor = 1.0 if found[2] == self.unit else OTHER_UNITS.get(self.unit, {}).get(found[2])
        return text if factor is None else float(found[1]) * factor

    def wrong(self, value: object) -> str | None:
        """Sentence on what is wrong with a value, and the mend; None for a possible one. 2.0 is no whole number."""
        if value is None and self.optional:
            return None
        if self.many:
            if not isinstance(value, tuple | list):
                return f"{self.name} is {shown(value)}; give a list"
            return next(filter(None, (self._wrong(item) for item in value)), None)
        return self._wrong(value)

    def _wrong(self, value: object) -> str | None:
        if self.choices:
            known = in_words(self.choices)
            return None if value in self.choices else f"{self.name} is {shown(value)}; give {known}"
        if self.kind in (str, bool):
            wanted = "a text" if self.kind is str else "true or false"
            return None if isinstance(value, self.kind) else f"{self.name} is {shown(value)}; give {wanted}"
        if self.kind not in (int, float):
            return None
        number = isinstance(value, int if self.kind is int else int | float) and not isinstance(value, bool)
        if number and _within_floats(value) and self.about.allows(float(typing.cast(float, value))):
            return None
        unit = f" {self.unit}" if number and self.unit else ""
        meant = f"; {told}" if number and (told := self._looks_like(value)) else ""
        about, size = (
            self.about,
            abs(float(typing.cast(float, value))) if number and _within_floats(value) else math.inf,
        )
        huge = about.finite and about.at_most == about.below == math.inf and LARGEST < size < math.inf
        mend = f"a number of a size up to {LARGEST:g}" if huge else self.about.possible(self.kind, self.unit)
        timed = ", or a time with its unit, like 1.5h" if isinstance(value, str) and self.unit == "min" else ""
        return f"{self.name} is {shown(value)}{unit}; give {mend}{timed}{meant}"

    def _looks_like(self, value: Any) -> str | None:
        return None if self.about.quantity is None else self.about.quantity.looks_like(value)

    def check(self, value: object, called: str | None = None) -> Any:
        """A value in the type of the setting.

        Raises
        ------
        Refusal
            For a value of another type, out of the bounds, or not among the choices; `called` is what the user called
            the part or the option.
        """
        wrong = self.wrong(value)
        if wrong is None and self.about.reads is not None:
            try:
                return self.about.reads(value)
            except Refusal as error:
                wrong = f"{self.name} is {shown(value)}; {error}"
        if wrong is not None:
            raise Refusal(f"{called}: {wrong}" if called else wrong)
        if self.many and value is not None:
            return tuple(self._typed(item) for item in typing.cast(Iterable[Any], value))
        return self._typed(value)

    def _typed(self, value: Any) -> Any:
        return float(value) if self.kind is float and isinstance(value, int | float) else value

    def ask(self, value: object, called: str | None = None, otherwise: Quantity | None = None) -> None:
        """Ask about a value that is possible and implausible; `otherwise` is the quantity of a number that has none.

        Raises
        ------
        Refusal
            With the unit that it looks like, if there is one.
        """
        quantity = self.about.quantity or (otherwise if self.kind in (int, float) else None)
        if quantity is None or value is None:
            return
        for number in value if isinstance(value, tuple | list) else (value,):
            asked = doubt(float(number), quantity, called or self.name, CONFIRM_OPTION)
            if asked is not None:
                raise Refusal(asked)


def _bound(value: float) -> str:
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e15 else f"{value:g}"


def in_words(choices: Sequence[object]) -> str:
    """Choices in words: ``a, b or c``."""
    *first, last = map(str, choices)
    return f"{', '.join(first)} or {last}" if first else last


def shown(value: object) -> str:
    """A value in a message."""
    text = f"{value:g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def _within_floats(value: Any) -> bool:
    try:
        float(value)
    except OverflowError:
        return False
    return True


def described(name: str, hint: Any, default: Default) -> Setting:
    """Setting that an annotated field declares.

    Raises
    ------
    TypeError
        For a field without a description.
    """
    about = next((part for part in getattr(hint, "__metadata__", ()) if isinstance(part, About)), None)
    if about is None:
        raise TypeError(
            f"the setting {name} does not say what it means; annotate it, like "
            f'{name}: Annotated[float, About("Gain, in mU/min per mg/dl.")] = 1.0'
        )
    kind = hint.__origin__
    branches = typing.get_args(kind) if isinstance(kind, types.UnionType) else ()
    optional = type(None) in branches
    if optional:
        [kind] = (branch for branch in branches if branch is not type(None))
    many = typing.get_origin(kind) is tuple
    if many:
        kind = typing.get_args(kind)[0]
    choices = typing.get_args(kind) if typing.get_origin(kind) is Literal else ()
    return Setting(name, type(choices[0]) if choices else kind, choices, optional, many, default, about)


def refuse_unknown_keys(keys: Iterable[str], known: Iterable[str], of: str = "") -> None:
    """Raise ValueError for the first key that is not known; ``of`` says of what: ``" of a trial"``."""
    names = list(known)
    for key in keys:
        if key not in names:
            told = known_names(key, names, where=AMONG_SETTINGS)
            raise Refusal(f"unknown key {key!r}{of}; {told}")


def with_article(noun: str) -> str:
    """A noun with its article."""
    return f"{'an' if noun[:1] in 'aeio' else 'a'} {noun}"


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
