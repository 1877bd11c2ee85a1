"""Entries and treatments of Nightscout as tables and lines, brought to the items that its JSON has.

Programs that make a table of treatments give each name of the JSON a column: `complex-json2csv`, with which the OpenAPS
Data Commons are read, and those that export a site. Entries come without a header, as the interface of a site writes
them (time, milliseconds since 1970, glucose, direction, device), or as a time and glucose.
"""

from __future__ import annotations

import re
from typing import Any, Final

from glucoloop.records.file_text import FileText
from glucoloop.refusal import Refusal

_TREATMENTS: Final = ("created_at", "eventType")
_ENTRIES: Final = ("dateString", "sgv")
_LINE: Final = re.compile(
    r'^"?(\d{4}-\d\d-\d\dT[^",\t]*)"?[,\t](\d{12,13})[,\t](\d*)[,\t]"?[^",\t]*"?[,\t]"?([^"\t]*)"?$'
)
_PAIR: Final = re.compile(r'^"?(\d{4}-\d\d-\d\dT\d\d:\d\d[^",\t]*), *(\d{1,3}|null)"?$')
_NONE: Final = ("", "null", "none", "nan", "undefined")
_WORDS: Final = (
    "created_at",
    "eventType",
    "dateString",
    "enteredBy",
    "device",
    "profile",
    "profileJson",
    "notes",
    "_id",
)
"""Names whose values are texts, also those that look like numbers."""


def is_table(content: FileText) -> bool:
    """Whether a file has treatments with a header, or entries without one."""
    return _header(content) is not None or _line_of(content) is not None


def items_of(content: FileText) -> list[dict[str, Any]]:
    """Items of a table or of lines; an empty one for a line that is none."""
    line = _line_of(content)
    if line is not None:
        entries = (line.match(text.strip()) for text in content.text.split("\n") if text.strip())
        return [_entry(one) if one else {} for one in entries]
    place = _header(content)
    if place is None:
        raise Refusal("it has no columns created_at and eventType, or dateString and sgv; export it again")
    table = content.table(place)
    names = {name: _name(name) for name in table.frame.columns}
    rows = [
        {names[key]: _value(names[key], text) for key, text in row.items()} for row in table.frame.iter_rows(named=True)
    ]
    for row, reason in zip(rows, table.spoilt, strict=True):
        if reason is not None:
            row.clear()
    return rows


def _header(content: FileText) -> tuple[int, str] | None:
    return content.header(*_TREATMENTS, whole=True) or content.header(*_ENTRIES, whole=True)


def _line_of(content: FileText) -> re.Pattern[str] | None:
    """Form of the lines of entries; None if they have neither."""
    lines = [line.strip() for line in content.head[:5]]
    if any(_LINE.match(line) for line in lines):
        return _LINE
    return _PAIR if lines and _PAIR.match(lines[0]) else None


def _entry(line: re.Match[str]) -> dict[str, Any]:
    if line.re is _PAIR:
        return {"type": "sgv", "dateString": line[1], "sgv": None if line[2] == "null" else line[2]}
    return {"dateString": line[1], "date": int(line[2]), "sgv": line[3] or None, "device": line[4]}


def _name(name: str) -> str:
    """Name of the JSON for that of a column."""
    return next((one for one in (*_TREATMENTS, *_ENTRIES) if one.casefold() == name.casefold()), name)


def _value(name: str, text: str | None) -> Any:
    """Value of a cell, as JSON would have it."""
    text = (text or "").strip(' "')
    if text.casefold() in _NONE:
        return None
    if name in _WORDS:
        return text
    if text.casefold() in ("true", "false"):
        return text.casefold() == "true"
    return float(text) if re.fullmatch(r"[-+]?\d{1,16}(\.\d+)?", text) else text
