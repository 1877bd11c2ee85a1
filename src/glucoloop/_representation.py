"""Short representations of records that users hold: a line in a terminal, a table in a notebook."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Mapping
from typing import Any, Final, TypeVar

T = TypeVar("T")

_MAX_ITEMS: Final = 4
"""Largest number of items of a list that are written out."""
_MAX_CHARACTERS: Final = 60
"""Largest length of a value."""


def represented(cls: type[T]) -> type[T]:
    """Decorator that gives a dataclass a short `repr`, and the same as a table of fields for notebooks.

    An array is named by its type and shape, a nested record by its class. Not for what is part of a compiled program,
    of which the whole `repr` is in digests.
    """
    cls.__repr__ = _line  # type: ignore[method-assign]
    cls._repr_html_ = _table  # type: ignore[attr-defined]
    return cls


def _line(record: Any) -> str:
    fields = ", ".join(f"{name}={text}" for name, text in _fields(record).items())
    return f"{type(record).__name__}({fields})"


def _table(record: Any) -> str:
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>" for name, text in _fields(record).items()
    )
    return f"<table><caption>{html.escape(type(record).__name__)}</caption>{rows}</table>"


def _fields(record: Any) -> dict[str, str]:
    values = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    left_out = (None, ())
    return {name: _short(value) for name, value in values.items() if not any(value is no for no in left_out)}


def _short(value: Any) -> str:
    """A value in a few words."""
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and dtype is not None:
        return _number(value) if shape == () else f"{dtype}{list(shape)}"
    if shape is not None:  # a table
        return f"{type(value).__name__} of {shape[0]} rows, {shape[1]} columns"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return f"{type(value).__name__}(...)"
    if isinstance(value, Mapping):
        return f"{len(value)} items" if len(value) > _MAX_ITEMS else repr(dict(value))[:_MAX_CHARACTERS]
    if isinstance(value, tuple | list):
        items = [_short(item) for item in value[:_MAX_ITEMS]] + ["..."] * (len(value) > _MAX_ITEMS)
        return f"({', '.join(items)})"
    text = f"{value:g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= _MAX_CHARACTERS else f"{text[: _MAX_CHARACTERS - 3]}..."


def _number(value: Any) -> str:
    """A scalar array; one that JAX traces has no number."""
    try:
        return f"{value.item():g}" if value.dtype.kind in "fiu" else str(value.item())
    except Exception:
        return f"{value.dtype}[]"
