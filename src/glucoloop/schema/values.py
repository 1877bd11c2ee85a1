"""Plain values of a file that glucoloop wrote: their form is declared as a class, and one check reads them.

A file may come from another person, or be damaged; so it is checked like any other input, whoever seems to have
written it. A form is a frozen dataclass. Its annotations say what stands under each key: ``float``, ``int``, ``bool``,
``str``, ``Literal``, ``X | None``, ``list[X]``, ``tuple[X, ...]``, ``dict[str, X]``, another form, or ``Any`` for plain
values of any kind. `ValueBounds` in an ``Annotated`` limits a number, or the length of a text, a list or a table. Keys
without a default have to be there, and others than these are refused. What ``__post_init__`` of a form refuses is a
sentence on the values together.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, TypeVar, Union

from glucoloop.refusal import Refusal
from glucoloop.text import is_printable, one_line, shown

F = TypeVar("F")

_LARGEST_INTEGER: Final = 2**63 - 1
_LONGEST_TEXT: Final = 1_000_000
_DEEPEST: Final = 10
"""Number of tables and lists within one another that a value of any kind may have."""


@dataclass(frozen=True, kw_only=True)
class ValueBounds:
    """Bounds of a number, and of the length of a text, a list or a table; the bounds themselves are possible."""

    at_least: float = -math.inf
    at_most: float = math.inf
    shortest: int = 0
    longest: float = math.inf

    def check(self, value: Any, place: str) -> None:
        """Refuse a value outside the bounds."""
        if isinstance(value, int | float) and not self.at_least <= value <= self.at_most:
            ends = ((self.at_least, "at least"), (self.at_most, "at most"))
            said = " and ".join(f"{words} {end:g}" for end, words in ends if math.isfinite(end))
            raise Refusal(f"{place} is {shown(value)}; it should be {said}")
        if isinstance(value, str | list | tuple | dict) and not self.shortest <= len(value) <= self.longest:
            what = "letters" if isinstance(value, str) else "items"
            most = f" and at most {self.longest:g}" if math.isfinite(self.longest) else ""
            raise Refusal(f"{place} has {len(value)} {what}; it should have at least {self.shortest}{most}")


_NONE: Final = ValueBounds()


def json_value(text: str | bytes) -> Any:
    """Value of a JSON text; Refusal for any other text, a key that is there twice, and what JSON does not have."""
    try:
        return json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_table)
    except Refusal:
        raise
    except RecursionError:
        raise Refusal("it is nested too deeply") from None
    except ValueError as error:  # also a number of thousands of digits, and bytes that are no text
        raise Refusal(f"it is not JSON: {one_line(error)}") from None


def _refuse_constant(name: str) -> None:
    raise Refusal(f"it has {name} in the place of a finite number; JSON has none but those")


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        raise Refusal(f"the key {shown(next(key for key in keys if keys.count(key) > 1))} is there twice")
    return table


def checked(form: type[F], value: object, place: str = "") -> F:
    """A value of a file in its form; Refusal, as a clause that names the place in the file, for any other."""
    result: F = _value(form, value, place)
    return result


def _value(hint: Any, value: Any, place: str, bounds: ValueBounds = _NONE) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    name = place or "it"
    if origin is Annotated:
        within = next((limit for limit in arguments[1:] if isinstance(limit, ValueBounds)), bounds)
        return _value(arguments[0], value, place, within)
    if origin in (Union, types.UnionType):
        if value is None:
            return None
        [hint] = (argument for argument in arguments if argument is not types.NoneType)
        return _value(hint, value, place, bounds)
    if origin is Literal:
        if isinstance(value, bool) or value not in arguments:
            raise Refusal(f"{name} is {shown(value)}; it should be {' or '.join(map(repr, arguments))}")
        return value
    if hint is Any:
        return _plain_value(value, place)
    if origin is list or origin is tuple:
        items = _of_type(list, value, name)
        bounds.check(items, name)
        every = [_value(arguments[0], item, _inside(place, number)) for number, item in enumerate(items)]
        return every if origin is list else tuple(every)
    if origin is dict:
        table = _of_type(dict, value, name)
        bounds.check(table, name)
        key_of = functools.partial(_value, arguments[0], place=f"a key of {name}")
        return {key_of(key): _value(arguments[1], table[key], _inside(place, key)) for key in table}
    if dataclasses.is_dataclass(hint):
        return _form(hint, _of_type(dict, value, name), place)
    result = _text(value, name) if hint is str else _of_type(hint, value, name)
    bounds.check(result, name)
    return result


_WORDS: Final[dict[type, str]] = {
    list: "a list",
    dict: "an object",
    float: "a finite number",
    int: "a whole number",
    bool: "true or false",
    str: "a text",
}


def _of_type(kind: type, value: Any, name: str) -> Any:
    """A value of a type; True is no number, and a whole one is a number."""
    right = isinstance(value, int | float if kind is float else kind) and (kind is bool or not isinstance(value, bool))
    if right and isinstance(value, int | float):
        right = abs(value) <= _LARGEST_INTEGER if isinstance(value, int) else math.isfinite(value)
    if not right:
        raise Refusal(f"{name} is {shown(value)}; it should be {_WORDS[kind]}")
    return float(value) if kind is float else value


def _text(value: Any, name: str) -> str:
    text: str = _of_type(str, value, name)
    if len(text) > _LONGEST_TEXT:
        raise Refusal(f"{name} has {len(text)} letters; it should have at most {_LONGEST_TEXT}")
    if not is_printable(text):
        raise Refusal(f"{name} is {shown(text)}; it should have no control characters")
    return text


def _form(form: Any, table: Mapping[str, Any], place: str) -> Any:
    hints = _hints(form)
    for key in table:
        if key not in hints:
            raise Refusal(f"{_inside(place, key)} is not a known key; leave it out")
    result: dict[str, Any] = {}
    for field in dataclasses.fields(form):
        if field.name in table:
            result[field.name] = _value(hints[field.name], table[field.name], _inside(place, field.name))
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise Refusal(f"{_inside(place, field.name)} is missing; add it")
    return form(**result)


@functools.cache
def _hints(form: type) -> dict[str, Any]:
    return typing.get_type_hints(form, include_extras=True)


def _plain_value(value: Any, place: str, depth: int = 0) -> Any:
    """A value of any kind: finite, not too deep, and of texts that can be written again."""
    name = place or "it"
    if depth > _DEEPEST:
        raise Refusal(f"{name} is nested more than {_DEEPEST} times")
    for text in _texts(value):
        try:
            text.encode()
        except UnicodeEncodeError:
            raise Refusal(f"{name} is {shown(text)}; it should have no halves of characters") from None
    if isinstance(value, dict):
        return {key: _plain_value(item, _inside(place, key), depth + 1) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain_value(item, _inside(place, number), depth + 1) for number, item in enumerate(value)]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _of_type(type(value), value, name)
    return value


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from value


def _inside(place: str, key: object) -> str:
    """Place of a value in the file, like ``provenance.notes.2``."""
    text = str(key)
    text = text if text.isprintable() and len(text) <= 60 else shown(text)
    return f"{place}.{text}" if place else text
