"""Text of keys and values in one line: ``move_weight=1, constraints=qp``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import Final

from glucoloop.parts.number_text import number_of, with_minutes
from glucoloop.refusal import Refusal

_TRUTHS: Final = {"true": True, "false": False}


def keyed_values(parts: Iterable[str], of: str, example: str) -> dict[str, object]:
    """Keys and values of parts like ``move_weight=1``.

    Raises
    ------
    ValueError
        For a part of another form, or a repeated key; `of` and `example` are for the message.
    """
    keys: dict[str, object] = {}
    for part in parts:
        key, _, value = (piece.strip() for piece in part.partition("="))
        if not key or not value:
            raise Refusal(f"{part!r} in the {of} is not a key with a value; write it like {example}")
        if key in keys:
            raise Refusal(f"{key} is given twice in the {of}; leave one out")
        keys[key] = with_minutes(key, value_of(value))
    return keys


def value_of(text: str) -> object:
    """A number or a truth value if the text is one, the text within quotes, and otherwise the text itself."""
    if text in _TRUTHS:
        return _TRUTHS[text]
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return number_of(text, kind)
    quoted = len(text) >= 2 and text[0] == text[-1] and text[0] in "'\""
    return text[1:-1] if quoted else text
