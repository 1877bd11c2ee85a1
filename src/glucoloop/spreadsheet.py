"""Texts in CSV tables, which a spreadsheet must not take for formulas.

A spreadsheet computes a cell that begins with ``=``, ``+``, ``-``, ``@``, a tab or a line end, whoever wrote it. OWASP,
"CSV Injection", puts an apostrophe before such a text: https://owasp.org/www-community/attacks/CSV_Injection
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from typing import Any, Final, Protocol

_UNSAFE: Final = r"(?='*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20])"
"""Beginning of a formula, in wide letters too; apostrophes before it are counted, so that the way back is known."""
_START: Final = r"(?:^|(?<=[;\t\r\n]))"
"""Beginning of a text, or of what a spreadsheet takes for another cell where semicolons or tabs divide them."""
_FORMULA: Final = re.compile(_START + _UNSAFE)
_APOSTROPHE: Final = re.compile(f"{_START}'{_UNSAFE}")
_QUOTED: Final = re.compile(r'[",\r\n]')


class _Writable(Protocol):
    def write(self, text: str, /) -> object: ...


def text_cell(text: str) -> str:
    """The cell of a text: the text itself, with an apostrophe wherever a formula would begin."""
    return _FORMULA.sub("'", text)


def text_of_cell(cell: str) -> str:
    """The text of a cell that `text_cell` made."""
    return _APOSTROPHE.sub("", cell)


def write_rows(out: _Writable, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV table with the names of its columns; texts are safe cells, and numbers stay numbers."""
    for row in itertools.chain([names], rows):
        out.write((",".join(map(_cell, row)) or '""') + "\n")


def _cell(value: Any) -> str:
    text = text_cell(value) if isinstance(value, str) else "" if value is None else str(value)
    return '"' + text.replace('"', '""') + '"' if _QUOTED.search(text) else text
