"""Entries of parts with settings, from which options, help, keys of files and checks follow; and their texts.

A part is written in one line as its name and its settings: ``missing, start_min=120, duration_min=30``.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

from glucoloop.refusal import Refusal
from glucoloop.registry.keyed_values import keyed_values
from glucoloop.registry.plugins import Catalogue, loaded, made_by
from glucoloop.registry.settings import Setting, Value, known_names, settings_of


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Description of a part that is available without making it.

    Raises
    ------
    ValueError
        For a place that is not written as ``module:function``, or a default that its setting does not allow.
    """

    kind: ClassVar[str]
    """Kind of the part in messages: ``"controller"``."""

    name: str
    summary: str
    record: type | str | None = None
    """Settings: a class made by `registry.settings.settings_record`, or ``module:Class``, or None without settings."""

    def __post_init__(self) -> None:
        for place in (*self.places, self.record):
            if isinstance(place, str) and not all(place.partition(":")):
                raise Refusal(f"{place!r} of the {self.kind} {self.name} is no place; write it like module:function")
        if not isinstance(self.record, type):
            return
        for setting in self.settings:
            for noisy in (False, True):
                try:
                    setting.check(setting.default.value(noisy=noisy))
                except Refusal as error:
                    raise Refusal(f"a default of the {self.kind} {self.name} is not allowed: {error}") from None

    @property
    def places(self) -> tuple[object, ...]:
        """Names of functions, each to be written as ``module:function``."""
        return ()

    @functools.cached_property
    def settings(self) -> tuple[Setting, ...]:
        """Settings, as the record declares them.

        Raises
        ------
        ValueError
            For a record that cannot be found, or does not declare its fields.
        """
        record = self._record
        return () if record is None else settings_of(record)

    @property
    def _record(self) -> type | None:
        if isinstance(self.record, str):
            record: type = loaded(self.record)
            return record
        return self.record

    def values(self, given: Mapping[str, Value]) -> Any:
        """Record of the given settings, and defaults for the others; None for a part without settings.

        Raises
        ------
        ValueError
            For a value out of its bounds.
        """
        record = self._record
        return None if record is None else record(**given)

    def setting(self, name: str) -> Setting:
        """A setting by name.

        Raises
        ------
        ValueError
            If there is no such setting.
        """
        known = {setting.name: setting for setting in self.settings}
        if name not in known:
            raise Refusal(f"the {self.kind} {self.name} has no setting {name!r}; {known_names(name, known)}")
        return known[name]

    def complete(self, given: Mapping[str, object]) -> dict[str, Value]:
        """All settings: the given ones, and defaults without noise for the others.

        Raises
        ------
        ValueError
            For an unknown setting, or a value of the wrong type or out of its bounds.
        """
        checked = {name: self.setting(name).check(value) for name, value in given.items()}
        every = {setting.name: checked.get(setting.name, setting.default.noise_free) for setting in self.settings}
        self.values(every)
        return every


@dataclass(frozen=True, kw_only=True)
class PartEntry(Entry):
    """Description of a sensor, pump, fault or metric, which a function makes of its settings."""

    make: str
    """``module:function`` that makes the part; a class will do. It is called by name with all settings, and with
    whatever else is known if it has a parameter of that name.
    """

    @property
    def places(self) -> tuple[object, ...]:
        """Names of functions, each to be written as ``module:function``."""
        return (self.make,)

    def made(self, settings: Mapping[str, Value], **known: Any) -> Any:
        """The part; making it imports JAX.

        Parameters
        ----------
        settings : mapping
            All settings.
        known : Any
            Further arguments, of which the function is given those for which it has a parameter.

        Raises
        ------
        ValueError
            If there is no such function, or the part is not possible.
        """
        maker: Callable[..., Any] = loaded(self.make)
        taken = inspect.signature(maker).parameters
        return made_by(maker, **settings, **{name: value for name, value in known.items() if name in taken})


P = TypeVar("P", bound=PartEntry)


@dataclass(frozen=True)
class Choice(Generic[P]):
    """A part that was asked for, with all its settings."""

    name: str
    """Name by which it was asked for."""
    entry: P
    settings: Mapping[str, Value]

    @property
    def text(self) -> str:
        """Text from which the same choice is read."""
        return part_text(self.name, self.settings)

    def made(self, **known: Any) -> Any:
        """The part; see `PartEntry.made`."""
        return self.entry.made(self.settings, **known)


class PartCatalogue(Catalogue[P]):
    """Catalogue of parts, each of which is chosen by a text of its name and its settings.

    Parameters
    ----------
    what, kind, entries : optional
        As for `Catalogue`.
    example : str
        Text of a choice, for messages.
    """

    def __init__(self, what: str, kind: type[P], entries: Iterable[P], *, example: str) -> None:
        super().__init__(what, kind, entries)
        self._example = example

    def choose(self, text: str) -> Choice[P]:
        """Read a choice from its text; settings that it does not give have their defaults.

        Raises
        ------
        ValueError
            For a text that is no choice, an unknown part or setting, or a value of the wrong type or out of its bounds.
        """
        name, given = parsed(text, self._what, self._example)
        entry = self.find(name)
        return Choice(name, entry, entry.complete(given))


def parsed(text: str, what: str, example: str) -> tuple[str, dict[str, object]]:
    """Name and given settings of a part from its text.

    Raises
    ------
    ValueError
        For a text that is not one; `what` and `example` are for the message.
    """
    name, _, rest = text.partition(",")
    if not name.strip() or "=" in name:
        raise Refusal(f"{text!r} is not a {what}; write one like {example!r}")
    parts = [part.strip() for part in rest.split(",")] if rest.strip() else []
    return name.strip(), keyed_values(parts, f"{what} {text!r}", example.partition(", ")[2].partition(",")[0])


def part_text(name: str, settings: Mapping[str, Value]) -> str:
    """Text from which the same part is read."""
    return ", ".join([name, *(f"{key}={_value_text(value)}" for key, value in settings.items())])


def _value_text(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and math.isfinite(value):
        return repr(value).removesuffix(".0")
    return str(value)
