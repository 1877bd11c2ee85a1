"""A setting of a component: meaning, bounds and unit, check and reading of a value, option, and range of a search.

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
from typing import Any, Final, Literal, Self

from glucoloop.component.effects import Need
from glucoloop.refusal import Refusal
from glucoloop.text import shown
from glucoloop.unit_guess import CONFIRM_OPTION, Quantity, refuse_unusual
from glucoloop.units import NUMBER, OTHER_UNITS, UNIT_BY_ENDING, ending_of, factor_to

Value = int | float | str | bool


class WithUnit(float):
    """A number in the unit of its setting that was given in another one, with the text in which it was given."""

    text: str

    def __new__(cls, number: float, text: str) -> Self:
        """Make one; everything that is computed from it is a plain number."""
        made = super().__new__(cls, number)
        made.text = text
        return made

    def __reduce__(self) -> tuple[type[WithUnit], tuple[float, str]]:
        return WithUnit, (float(self), self.text)


_NUMBER: Final = re.compile(rf"(?P<number>(?a:{NUMBER})|[-+]?(?:inf|nan))\s*(?P<unit>[A-Za-z(%][A-Za-z ²^2()/]*)?")
LARGEST: Final = 1e30
"""Largest size of a number, so that no product of a few of them overflows."""
_MAX_NAMES: Final = 16
ALL_SETTINGS: Final = "--help of the command has each, and glucoloop list"
"""Text on where all settings are described."""
_SHORTEST_WORD: Final = 4
"""Length from which a part of a name says what it is about; shorter ones are mostly units."""


@dataclass(frozen=True)
class About:
    """Meaning of a setting and its possible values: the annotation of a field of a `component.Component`.

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
    needs: tuple[Need, ...] = ()
    """Needs that components of the request have to meet, so that the setting has an effect; see `situations.unused`."""

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
        limits = {
            "of {} or more": self.at_least,
            "above {}": self.above,
            "up to {}": self.at_most,
            "below {}": self.below,
        }
        bounds = [limit.format(f"{_bound(value)}{unit}") for limit, value in limits.items() if math.isfinite(value)]
        return f"{what} {' and '.join(bounds)}" if bounds else f"{what}{unit}"


@dataclass(frozen=True)
class Default:
    """Value of a setting that was not given; it may depend on whether readings are noisy."""

    noise_free: Any
    noisy: Any = None
    """Value with noisy readings, or None for the same as without noise."""

    def value(self, *, noisy: bool) -> Any:
        """Value for a run with or without noise."""
        return self.noisy if noisy and self.noisy is not None else self.noise_free


Tunings = Mapping[str, Mapping[str, Default]]
"""Default values of settings for a patient, by controller and setting, where they differ from the controller's own."""


def default_by_noise(*, default: Any, noisy: Any) -> Any:
    """Default of a field of a component, which may differ with noisy readings."""
    return dataclasses.field(default=default, metadata={"noisy": noisy})


def value_text(value: Any) -> str:
    """A value as it is written."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(value)


def number_with_unit(text: str, unit: str) -> float | None:
    """Number in a unit from its text, which may have that unit or another of its quantity; None if it has not."""
    result = _NUMBER.fullmatch(text)
    factor = None if result is None else factor_to(unit, result["unit"] or unit)
    if result is None or factor is None:
        return None
    number = float(result["number"])
    return number if factor == 1.0 else WithUnit(number * factor, text)


@dataclass(frozen=True)
class Setting:
    """A declared setting of a component."""

    name: str
    kind: Any
    """Type without None; of a list the type of its items, and str for one of several choices."""
    choices: tuple[Any, ...]
    optional: bool
    many: bool
    default: Default
    about: About
    requested: bool = False
    """Whether its values are requests of components, which are completed later."""

    @property
    def summary(self) -> str:
        """Sentence on the setting."""
        return self.about.summary

    @property
    def unit(self) -> str:
        """Unit of a number."""
        declared = self.about.unit or (self.about.quantity.unit if self.about.quantity is not None else "")
        return declared or UNIT_BY_ENDING.get(ending_of(self.name), "")

    @property
    def name_without_unit(self) -> str:
        """Name by which a setting is found too: ``setpoint`` for ``setpoint_mg_dl``."""
        return self.name.removesuffix(ending_of(self.name)) or self.name

    @property
    def possible(self) -> str:
        """Possible values in words, of a number with the other units in which it may be given."""
        if self.is_component:
            return f"{'components' if self.many else 'a component'} of the kind {self.kind.kind}"
        if self.choices:
            return choices_text(self.choices)
        if self.kind not in (int, float):
            return "true or false" if self.kind is bool else "a text"
        others = [name for name in OTHER_UNITS.get(self.unit, {}) if name != "m"]
        also = f", or one in {choices_text(others)}" if others and self.kind is float else ""
        return self.about.possible(self.kind, self.unit) + also

    @property
    def is_component(self) -> bool:
        """Whether its values are components, which have a catalogue."""
        return isinstance(self.kind, type) and hasattr(self.kind, "catalogue")

    def settled(self, value: Any) -> Any:
        """A component, complete unless the values are requests; None for none."""
        from glucoloop.component.request import Request, completed, request_of

        if value is None:
            return None
        return request_of(value) if self.requested else completed(value) if isinstance(value, Request) else value

    def renamed(self, name: str) -> Setting:
        """The same setting under the name of its option, in the same unit."""
        return dataclasses.replace(self, name=name, about=dataclasses.replace(self.about, unit=self.unit))

    def read(self, text: str) -> object:
        """Value of a text in the type of the setting; the text itself where it is none, which `check` refuses.

        A number may have its unit, or another of its quantity.
        """
        text = text.strip()
        if self.kind is bool:
            return {"true": True, "false": False}.get(text, text)
        if self.kind is int:
            return int(text) if re.fullmatch(r"[-+]?[0-9]{1,400}", text) else text
        result = number_with_unit(text, self.unit) if self.kind is float else None
        return text if result is None else result

    def has_type(self, value: object) -> bool:
        """Whether a single value is of the type of the setting; 2.0 is no whole number, and True is no number."""
        if isinstance(value, bool):
            return self.kind is bool
        return isinstance(value, int | float if self.kind is float else self.kind)

    def _wrong(self, value: object) -> str | None:
        """Sentence on what is wrong with a single value, and the mend; None for a possible one."""
        if self.choices or self.kind in (str, bool):
            right = value in self.choices if self.choices else self.has_type(value)
            return None if right else f"{self.name} is {shown(value)}; give {self.possible}"
        if self.kind not in (int, float):
            return None
        about = self.about
        amount, meant, mend = shown(value), "", self.possible
        if self.has_type(value):
            try:
                number = float(typing.cast(float, value))
                allowed = about.allows(number)
            except OverflowError:
                number, allowed = math.inf, False
            if allowed:
                return None
            amount = f"{amount} {self.unit}".rstrip()
            amount = f"{value.text}, which is {amount}" if isinstance(value, WithUnit) else amount
            if about.finite and about.at_most == about.below == math.inf and LARGEST < abs(number) < math.inf:
                mend = f"a number of a size up to {LARGEST:g}"
            quantity = None if isinstance(value, WithUnit) else about.quantity
            likeness = None if quantity is None else quantity.looks_like(typing.cast(float, value))
            meant = "" if likeness is None else f"; {likeness}"
        return f"{self.name} is {amount}; give {mend}{meant}"

    def check(self, value: object, label: str = "") -> Any:
        """A value in the type of the setting; refused if it is of another type, out of the bounds, or no choice.

        `label` is the name of the component or the option in the message.
        """
        if value is None and self.optional:
            wrong = None
        elif not self.many:
            wrong = self._wrong(value)
        elif isinstance(value, tuple | list):
            wrong = next(filter(None, map(self._wrong, value)), None)
        else:
            wrong = f"{self.name} is {shown(value)}; give a list"
        if wrong is None and self.about.reads is not None:
            try:
                return self.about.reads(value)
            except Refusal as error:
                wrong = f"{self.name}: {error}" if self.many else f"{self.name} is {shown(value)}; {error}"
        if wrong is not None:
            raise Refusal(f"{label}: {wrong}" if label else wrong)
        if self.many and value is not None:
            return tuple(map(self._typed, typing.cast(Iterable[Any], value)))
        return self._typed(value)

    def _typed(self, value: Any) -> Any:
        is_number = self.kind is float and isinstance(value, int | float)
        return float(value) if is_number and not isinstance(value, WithUnit) else value

    def refuse_unusual(self, value: object, label: str, otherwise: Quantity | None = None) -> None:
        """Refuse a value that is possible and implausible; `otherwise` is the quantity of a number that has none."""
        quantity = self.about.quantity or (otherwise if self.kind in (int, float) else None)
        if quantity is not None and value is not None:
            for number in value if isinstance(value, tuple | list) else (value,):
                others = () if isinstance(number, WithUnit) else quantity.others
                refuse_unusual(float(number), dataclasses.replace(quantity, others=others), label, CONFIRM_OPTION)


def _bound(value: float) -> str:
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e15 else f"{value:g}"


def choices_text(choices: Sequence[object]) -> str:
    """Choices in words: ``a, b or c``."""
    *first, last = map(str, choices)
    return f"{', '.join(first)} or {last}" if first else last


def declared_setting(name: str, hint: Any, default: Default) -> Setting:
    """Setting that an annotated field declares; TypeError for a field without a description."""
    about = next((component for component in getattr(hint, "__metadata__", ()) if isinstance(component, About)), None)
    if about is None:
        raise TypeError(
            f"the setting {name} does not say what it means; annotate it, like "
            f'{name}: Annotated[float, About("Gain, in mU/min per mg/dl.")] = 1.0'
        )
    kind = hint.__origin__
    branches = typing.get_args(kind) if typing.get_origin(kind) in (types.UnionType, typing.Union) else ()
    optional = type(None) in branches
    if optional:
        [kind] = (branch for branch in branches if branch is not type(None))
    many = typing.get_origin(kind) is tuple
    if many:
        kind = typing.get_args(kind)[0]
    choices = typing.get_args(kind) if typing.get_origin(kind) is Literal else ()
    requested = not choices and getattr(typing.get_origin(kind), "__name__", "") == "Request"
    if requested:
        [kind] = typing.get_args(kind)
    return Setting(name, type(choices[0]) if choices else kind, choices, optional, many, default, about, requested)


def known_names(unknown: str, known: Iterable[str], *, where: str = "") -> str:
    """Text about known names after an unknown one: the most similar one, and the others unless they are many.

    Where they are many and `where` says where all stand, those that share a word with the unknown one are named.
    """
    names = list(known)
    if not names:
        return "there are none"
    close = difflib.get_close_matches(unknown, names, n=1)
    if len(names) <= _MAX_NAMES:
        return f"{f'did you mean {close[0]!r}? ' if close else ''}the known ones are: {', '.join(names)}"
    if not close and where:
        words = {word for word in unknown.casefold().split("_") if len(word) >= _SHORTEST_WORD}
        close = [name for name in names if words & set(name.casefold().split("_"))]
        if not close or len(close) > _MAX_NAMES:
            return f"none of the {len(names)} known ones is like it; {where}"
    if not close:
        return f"the known ones are: {', '.join(names)}"
    return f"did you mean {close[0]!r}?" if len(close) == 1 else f"those like it are: {', '.join(close)}"


_ENDS: Final = 2
_DIGITS: Final = 4
"""Significant digits of a tuned number; more make no difference to a loop."""


@dataclass(frozen=True)
class Tuned:
    """A number that is searched for, from `low` to `high`, both included; the bounds are refused if they are none."""

    name: str
    """Name of the setting."""
    low: float
    high: float
    log: bool
    """Whether its logarithm is searched."""
    by_default: bool = True
    """Whether it is searched for even where no range is given."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise Refusal(
                f"{self.name} is searched from {self.low:g} to {self.high:g}; give two finite numbers, the lower first"
            )
        if self.log and not self.low > 0.0:
            raise Refusal(
                f"{self.name} is searched from {self.low:g} on, but by its logarithm; give a lower bound above 0"
            )

    def at(self, share: float) -> float:
        """Number at a share of the way from the lower bound to the upper one, 0 to 1."""
        if self.log:
            return self.rounded(self.low * (self.high / self.low) ** share)
        return self.rounded(self.low + (self.high - self.low) * share)

    def rounded(self, value: float) -> float:
        """A number rounded to the significant digits, within the bounds."""
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high)

    def holds(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        return self.low <= value <= self.high

    @property
    def text(self) -> str:
        """Text of the range, as it is written."""
        return f"{self.low:.12g}:{self.high:.12g}"


def parse_range(text: str, default: Tuned) -> Tuned | float:
    """Range from a text: ``.1:2``, with both ends; or one number, which is fixed. Numbers may have their unit.

    The default range of the setting says whether its logarithm is searched.
    """
    unit = UNIT_BY_ENDING.get(ending_of(default.name), "")
    numbers = [
        float(result) for part in text.split(":") if (result := number_with_unit(part.strip(), unit)) is not None
    ]
    if len(numbers) != text.count(":") + 1 or len(numbers) > _ENDS or not all(map(math.isfinite, numbers)):
        raise Refusal(f"{default.name} is {text!r}; write it like .1:2, or one number that is kept")
    if len(numbers) == 1:
        return numbers[0]
    try:
        return Tuned(default.name, numbers[0], numbers[1], log=default.log)
    except Refusal as error:
        raise Refusal(f"{default.name} is {text!r}: {error}") from None


PATIENT_PANEL = "Patient and meals"
SENSOR_PANEL = "Sensor and pump"
CONTROLLER_PANEL = "Controller"
PEOPLE_PANEL = "People"
WORK_PANEL = "Work"
RUN_PANEL = "Run"
OUTPUT_PANEL = "Files and output"
PANELS = (PEOPLE_PANEL, PATIENT_PANEL, SENSOR_PANEL, CONTROLLER_PANEL, RUN_PANEL, WORK_PANEL, OUTPUT_PANEL)
"""Headings of the help that commands share, in their order; those of a study of its own come first."""


@dataclass(frozen=True)
class Option(About):
    """Meaning of a setting and its possible values, and the option that stands for it."""

    panel: str = RUN_PANEL
    flag: str = ""
    """Name of the option; by default that of the setting without its unit."""
    metavar: str = ""
    """Placeholder of the value in help; by default the unit, or the choices."""
    default: str = ""
    """Default in words; by default the value."""
    rare: bool = False
    """Whether the help of commands only names it; `glucoloop list` with the name of the command describes it."""
    alone: str = ""
    """Text for which the option stands without a value, where it may."""
