"""Text that can be printed in one line, whatever its source, and numbers with their nouns."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final

NOT_AVAILABLE: Final = "n/a"
"""Text in the place of a number that is not known."""
NOT_VALID: Final = "not valid"
"""Text in the place of a glucose below 0: the valid range of the patient's model ended above it."""
_UNPRINTABLE: Final = re.compile(
    "[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]"
)
"""Control characters, ends of lines and paragraphs, lone surrogates, and marks that turn the direction of a text."""
_CREDENTIALS: Final = re.compile(
    r"(?<=:/)(/*)[^\s/@]+@|([?&;](?:[\w.-]*(?:token|secret|password|signature|credential|key)|sig|pwd)=)(?:[^\s&;#'\":]|:(?!\s))+",
    re.I,
)
"""Name and password in an address, and values of its query that are secrets by their names."""
_LONGEST_SHOWN: Final = 60


def is_printable(text: str) -> bool:
    """Whether a text can stand in a line and shows all that it holds: none of the characters above."""
    return _UNPRINTABLE.search(text) is None


def printable(text: str) -> str:
    """A text in one line, with the escape of what cannot be printed in its place."""
    return _UNPRINTABLE.sub(lambda letter: ascii(letter[0])[1:-1], text)


def without_credentials(text: str) -> str:
    """A text in which names, passwords and tokens of addresses are ``***``: libraries quote what they were given."""
    return _CREDENTIALS.sub(lambda match: f"{match[2]}***" if match[2] else f"{match[1]}***@", text)


def printable_lines(text: str) -> str:
    """A text of several lines, with the escape of what cannot be printed in its place."""
    return _UNPRINTABLE.sub(lambda letter: letter[0] if letter[0] in "\n\t" else printable(letter[0]), text)


def printable_json(text: str) -> str:
    """A JSON text of the same value, in which what cannot be printed stands as an escape."""
    return _UNPRINTABLE.sub(lambda letter: letter[0] if letter[0] == "\n" else f"\\u{ord(letter[0]):04x}", text)


def shown(value: object) -> str:
    """A value in a message."""
    text = f"{value:g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def one_line(message: object) -> str:
    """A message of somebody else in one line, to stand within a sentence."""
    return " ".join(str(message).split()).rstrip(".")


def how_many(count: int, one: str, many: str | None = None) -> str:
    """A number with its noun or verb: "1 person", "20 people"; `many` is by default `one` with an s."""
    return f"{count} {one if count == 1 else many or f'{one}s'}"


def the_first(names: Sequence[str], most: int = 5) -> str:
    """The first few names in one text, and the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


def glucose_text(glucose: float, digits: int = 1) -> str:
    """Text of a concentration of glucose, without its unit; one below 0 is not valid, and no number."""
    if not math.isfinite(glucose):
        return NOT_AVAILABLE
    return NOT_VALID if glucose < 0.0 else f"{glucose:z.{digits}f}"


def percent(share: float) -> str:
    """Shortest text of a percentage that does not round a few to none."""
    if not math.isfinite(share):
        return NOT_AVAILABLE
    share = round(share, 9)  # what is left of a sum of shares is neither a few nor nearly all
    if 0.0 < share < 0.01:
        return "< 0.01 %"
    if 99.99 < share < 100.0:
        return "> 99.99 %"
    digits = 2 if 0.0 < share < 1.0 or 99.0 < share < 100.0 else 1
    return f"{share:.{digits}f} %" if share not in (0.0, 100.0) else f"{share:.0f} %"
