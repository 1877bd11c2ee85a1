"""A validation error as one sentence that names the key, the value, the bound and the mend."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from glucoloop.parts.setting import About
from glucoloop.plausible import Quantity

_KINDS: Final = {
    "int": "a whole number",
    "float": "a number",
    "finite_number": "a finite number",
    "bool": "true or false",
    "string": "a text",
    "list": "a list",
    "tuple": "a list",
    "dict": "a table",
    "model": "a table",
}
_SIDES: Final = {"gt": "above", "ge": "of at least", "lt": "below", "le": "at most"}
_LONGEST_VALUE: Final = 60
_GROUPS: Final = ("tuning", "guard_limits")
"""Keys of records whose own keys stand among the others in a file."""


def one_sentence(error: ValidationError, record: type[BaseModel], names: Mapping[str, str] | None = None) -> str:
    """Describe the first error.

    Parameters
    ----------
    error : ValidationError
        Raised when `record` was built.
    record : type
    names : mapping, optional
        Name under which the user gave each key, such as an option of the command line.
    """
    errors = error.errors(include_url=False)
    # Where a value may be of several types, what is wrong with one that is not finite is told by the right one.
    first = next((one for one in errors if one["type"] == "finite_number"), errors[0])
    path = first["loc"][1:] if len(first["loc"]) > 1 and first["loc"][0] in _GROUPS else first["loc"]
    key = str(path[0]) if path else ""
    name = (names or {}).get(key, ".".join(str(part) for part in path if not _is_branch(part)))
    if first["type"] == "missing":
        return f"{name} is missing; add it"
    if first["type"] == "extra_forbidden":
        return f"{name} is not a known key; leave it out"
    if first["type"] == "json_invalid":
        return f"this is not JSON: {first['ctx']['error']}"
    value = first["input"]
    shown = f"{value:g}" if isinstance(value, float) else repr(value)
    shown = shown if len(shown) <= _LONGEST_VALUE else f"{shown[:_LONGEST_VALUE]}..."
    return f"{name} is {shown}; give {_wanted(first, record, key)}{_meant(value, record, key)}"


def _meant(value: object, record: type[BaseModel], key: str) -> str:
    """The unit in which a value beyond the bounds would be plausible."""
    found = record.model_fields.get(key)
    quantity = None if found is None else _quantity_of(found)
    if quantity is None or isinstance(value, bool) or not isinstance(value, int | float):
        return ""
    hint = quantity.looks_like(value)
    return "" if hint is None else f"; {hint}"


def _is_branch(part: int | str) -> bool:
    """Whether a part of a path names no key but a branch of a union."""
    return isinstance(part, str) and part.startswith(("constrained-", "function-", "float", "int", "str"))


def _wanted(error: Any, record: type[BaseModel], key: str) -> str:
    context = error.get("ctx", {})
    if error["type"] == "literal_error":
        return f"one of {context['expected']}"
    if error["type"] == "value_error":
        return str(context["error"])
    kind = next((text for start, text in _KINDS.items() if error["type"].startswith(start)), "")
    bounds = _bounds(record, key) if len(error["loc"]) == 1 else _in_words(context)
    if kind:
        return f"{kind} {bounds}".rstrip()
    return f"a value {bounds}" if bounds else str(error["msg"])


def _bounds(record: type[BaseModel], key: str) -> str:
    """Bounds of a field in words, complete, from its metadata."""
    found = record.model_fields.get(key)
    if found is None:
        return ""
    sides = ({side: getattr(item, side, None) for side in _SIDES} for item in found.metadata)
    return " and ".join(filter(None, map(_in_words, sides)))


def _in_words(bounds: Mapping[str, Any]) -> str:
    """Bounds by their side, in words."""
    found = {text: bounds.get(side) for side, text in _SIDES.items()}
    return " and ".join(
        f"{text} {bound:g}" if isinstance(bound, float) else f"{text} {bound}"
        for text, bound in found.items()
        if bound is not None
    )


def _quantity_of(field: FieldInfo) -> Quantity | None:
    """Quantity of a field with its plausible range; None if it is not declared."""
    return next((item.quantity for item in field.metadata if isinstance(item, About)), None)
