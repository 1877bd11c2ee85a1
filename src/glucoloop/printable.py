"""Text that can be printed in one line, whatever its source, and numbers with their nouns."""

from __future__ import annotations

import unicodedata
from typing import Final

_UNPRINTABLE: Final = ("Cc", "Cs", "Zl", "Zp")
"""Unicode categories of controls, lone surrogates, and ends of lines and paragraphs."""


def is_printable(text: str) -> bool:
    """Whether a text can stand in a line: no control characters, line ends or lone surrogates."""
    return not any(unicodedata.category(character) in _UNPRINTABLE for character in text)


def printable(text: str) -> str:
    """A text in one line, with the escape of what cannot be printed in its place."""
    if is_printable(text):
        return text
    return "".join(letter if is_printable(letter) else repr(letter)[1:-1] for letter in text)


def how_many(count: int, one: str, many: str | None = None) -> str:
    """A number with its noun or verb: "1 person", "20 people"; `many` is by default `one` with an s."""
    return f"{count} {one if count == 1 else many or f'{one}s'}"
