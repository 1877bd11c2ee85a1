"""Declaration of a key: type, bounds, unit and meaning, from which option, help, check and documentation follow.

A record of keys is a frozen dataclass whose fields are annotated with a `Key`. Nothing here imports a numerical
library, so that help is shown at once.
"""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from glucoloop.parts.setting import About

_METAVARS = {"_mg_dl": "MG_DL", "_mU_min": "MU_MIN", "_min": "MIN", "_pct": "PCT", "_variance": "VARIANCE"}
"""Placeholder of a value in help, by the unit at the end of a key."""


@dataclass(frozen=True)
class Key(About):
    """Meaning of a key and its possible values, and the option that stands for it.

    The bounds of a list are those of its items.
    """

    panel: str = ""
    """Heading of the help under which the option stands."""
    flag: str | None = None
    """Name of the option; by default that of the key without its unit. A switch has its opposite after a slash."""
    metavar: str | None = None
    """Placeholder of the value in help; by default the unit, or the choices."""
    told: str | None = None
    """Default in words; by default the value."""
    empty: tuple[str, str] | None = None
    """Name and sentence of a switch that makes a list empty."""


@dataclass(frozen=True)
class Declared:
    """A field of a record of keys."""

    name: str
    kind: Any
    """Type without None; of a list the type of its items; str for one of several choices."""
    choices: tuple[str, ...]
    optional: bool
    many: bool
    key: Key | None
    """Declaration of the key; None for a field that is no key of its own."""
    default: Any
    required: bool = False
    """Whether there is no default."""

    @property
    def flag(self) -> str:
        """Name of the option."""
        unit = next((ending for ending in _METAVARS if self.name.endswith(ending)), "")
        plain = f"--{self.name.removesuffix(unit).replace('_', '-')}"
        return plain if self.key is None or self.key.flag is None else self.key.flag

    @property
    def metavar(self) -> str | None:
        """Placeholder of the value in help; None for a switch."""
        if self.kind is bool:
            return None
        if self.key is not None and self.key.metavar is not None:
            return self.key.metavar
        unit = next((metavar for ending, metavar in _METAVARS.items() if self.name.endswith(ending)), None)
        return "|".join(self.choices) or unit or {int: "N", float: "X"}.get(self.kind, "NAME")

    @property
    def told(self) -> str | None:
        """Default in words, for help."""
        return text_of(self.default) if self.key is None or self.key.told is None else self.key.told


def text_of(value: object) -> str | None:
    """A default in words; None for one that goes without saying: none, off, or an empty list."""
    if isinstance(value, list | tuple):
        return ", ".join(str(text_of(item)) for item in value) or None
    if value is None or isinstance(value, bool):
        return None
    return f"{value:g}" if isinstance(value, float) else str(value)


@functools.cache
def declared(record: type) -> Mapping[str, Declared]:
    """The fields of a record of keys by name, in order."""
    hints = typing.get_type_hints(record, include_extras=True)
    return {field.name: _declared(field, hints[field.name]) for field in dataclasses.fields(record)}


def _declared(field: dataclasses.Field[Any], hint: Any) -> Declared:
    key = next((part for part in getattr(hint, "__metadata__", ()) if isinstance(part, Key)), None)
    kind = hint.__origin__ if key is not None else hint
    branches = typing.get_args(kind) if isinstance(kind, types.UnionType) else ()
    optional = type(None) in branches
    if optional:
        kind = next(branch for branch in branches if branch is not type(None))
    many = typing.get_origin(kind) is tuple
    if many:
        kind = typing.get_args(kind)[0]
    choices = typing.get_args(kind) if typing.get_origin(kind) is Literal else ()
    required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    return Declared(field.name, str if choices else kind, choices, optional, many, key, field.default, required)


def plain(record: Any) -> dict[str, Any]:
    """Values of a record of keys by name, as they stand in a file."""
    values = ((field.name, getattr(record, field.name)) for field in dataclasses.fields(record))
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values}


def own_keys(keys: Mapping[str, Any], record: type) -> dict[str, Any]:
    """Keys of a record among others."""
    return {key: value for key, value in keys.items() if key in declared(record)}


def quantities(record: type) -> Iterator[tuple[str, Any]]:
    """Name and quantity of each key that has a plausible range."""
    for name, of in declared(record).items():
        if of.key is not None and of.key.quantity is not None:
            yield name, of.key.quantity
