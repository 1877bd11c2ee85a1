"""Check of a record of keys: a value of another type or out of its bounds is refused in one sentence."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

from glucoloop.config.key import Declared, declared
from glucoloop.parts.setting import About, Default, Setting
from glucoloop.refusal import Refusal

Record = TypeVar("Record")
_CHECKED = (int, float, bool, str)


def checked(record: type[Record], keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Record:
    """Build a record from its keys.

    Parameters
    ----------
    record : type
        Record of keys, see `config.key`.
    keys : mapping
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    Refusal
        For a key that the record does not have, a value of another type, or one out of its bounds.
    """
    kind: Any = record
    known = declared(kind)
    for key in keys:
        if key not in known:
            raise Refusal(f"{(names or {}).get(key, key)} is not a known key; leave it out")
    for key, of in known.items():
        if key not in keys and of.required:
            raise Refusal(f"{(names or {}).get(key, key)} is missing; add it")
    return record(**{key: _checked(known[key], value, (names or {}).get(key, key)) for key, value in keys.items()})


def _checked(of: Declared, value: object, name: str) -> object:
    """A value of a key in its type; what is neither a number, a truth nor a text is left to its reader."""
    if of.kind not in _CHECKED:
        return value
    about = of.key or About("")
    unit = Setting(of.name, of.kind, of.choices, of.optional, of.many, Default(None), about).unit
    told = Setting(
        name, of.kind, of.choices, of.optional, of.many, Default(None), dataclasses.replace(about, unit=unit)
    )
    return told.check(value)
