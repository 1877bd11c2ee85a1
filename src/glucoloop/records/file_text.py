"""Text of a file whatever its encoding, and that text as a table or as JSON."""

from __future__ import annotations

import contextlib
import csv
import functools
import io
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import polars as pl

from glucoloop.records.answers import UNITS
from glucoloop.refusal import Refusal
from glucoloop.user_file import read_regular

LARGEST_BYTES: Final = 2_000_000_000
DELIMITERS: Final = (",", ";", "\t", "|")
MAX_ROWS: Final = 5_000_000
"""Largest number of rows or entries of a file: a reading a minute for nine years."""
_MAX_GROUPS, _MAX_VALUES = 10_000_000, 50_000_000
_MAX_COLUMNS: Final = 1000
MAX_CELLS: Final = 100_000_000
_SURROGATE: Final = re.compile(r"\\u[dD][89a-fA-F]")
_ESCAPE: Final = re.compile(
    r"\\(?:u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}|(u[dD][89a-fA-F][0-9a-fA-F]{2})|.)", re.DOTALL
)
"""Escape in JSON; half of a pair, which is no letter and cannot be encoded, is its group."""
_EMPTY: Final = "it is empty; give the file as it was exported"
_BLANK_LINES: Final = re.compile(r"\n(?:[ \t]*\n)+")
_MARKS: Final = (
    "\ufeff",
    "\ufffe",
    "\u00ef\u00bb\u00bf",
    "\u00ef\u00bb",
    "\u00bb\u00bf",
    "\u00ff\u00fe",
    "\ufffd\ufffd\ufffd",
)
_SEPARATOR_LINE: Final = re.compile(r'"?sep=.?"?[ \t]*\n')
"""First line by which a spreadsheet is told what divides the fields."""
_NUMBER: Final = re.compile(r"-?[0-9]+(?:[.,][0-9]*)?")
_IN_FULL: Final = 6
"""Number of decimals from which numbers are taken as written in full."""
_CUT_OFF: Final = "a last row that is cut off"
_COMPARED: Final = 50
"""Number of last lines that are compared with each other."""
_EXTRA: Final = ("more 1", "more 2")
"""Columns for fields beyond those of the header."""
_FIELD_END: Final = "\0"
"""Sign that no text has, between fields."""
_FIRST_OBJECTS: Final = 60
_BREAKS: Final = r"[\x00-\x1f\x7f\x{85}\x{2028}\x{2029}]+"
"""Signs that divide fields or lines, or may do so."""
_BEGINNING: Final = 40
"""Number of bytes of which every other one is zero where English is in UTF-16 without a mark."""
_DOCUMENTS: Final = {b"%PDF-": "a PDF", rb"{\rtf": "a document in RTF"}
"""Kind of a document, by the bytes with which it begins."""
_HEAD: Final = 20_000
"""Number of letters in which the beginning of a file is looked at."""


@dataclass(frozen=True)
class FileText:
    """Text of a file, and what had to be done to read it."""

    text: str
    notes: tuple[str, ...] = ()

    @functools.cached_property
    def head(self) -> tuple[str, ...]:
        """First lines of the text."""
        return tuple(self.text[:_HEAD].split("\n")[:60])

    @functools.cached_property
    def json(self) -> Any:
        """Value of the text as JSON, or None if it is none."""
        return json_of(self.text) if self.text[:_HEAD].lstrip()[:1] in ("[", "{") else None

    @functools.cached_property
    def items(self) -> list[Any] | None:
        """List of a text in JSON, or of what a program wraps it in: an answer's ``result``, or a line for each item."""
        value = self.json
        if value is None and self.text.lstrip().startswith("{"):
            value = _lines_of(self.text)
        if isinstance(value, dict):
            value = next((value[name] for name in ("result", "data") if isinstance(value.get(name), list)), None)
        if not isinstance(value, list):
            return None
        if '"$' not in self.text:
            return value
        try:
            return [_plain(item) for item in value]
        except RecursionError:
            return None

    @functools.cached_property
    def as_table(self) -> FileText:
        """Text with a row for each object where this one is JSON of such; else this one."""
        return self._rows_of_json(MAX_ROWS)

    @functools.cached_property
    def beginning_as_table(self) -> FileText:
        """The first rows of `as_table`, in which a header is looked for."""
        return self._rows_of_json(_FIRST_OBJECTS)

    def _rows_of_json(self, most: int) -> FileText:
        objects = _objects_of(self.json if isinstance(self.json, dict) else self.items)
        if not objects:
            return self
        names = list(dict.fromkeys(name for one in objects[:most] for name in one))
        table = pl.DataFrame({name: cells(one.get(name) for one in objects[:most]) for name in names})
        return FileText(text_of(table), self.notes)

    def header(self, *names: str, whole: bool = False) -> tuple[int, str] | None:
        """Number of the first line with fields that begin with these names, and its delimiter; None if there is none.

        With `whole` the fields have to be these names.
        """
        end = _FIELD_END if whole else ""
        marked = [f"{_FIELD_END}{name.casefold()}{end}" for name in names]
        every, lines = self._joined_fields
        if all(name in every for name in marked):
            return next((place for place, joined in lines if all(name in joined for name in marked)), None)
        return None

    @functools.cached_property
    def _joined_fields(self) -> tuple[str, list[tuple[tuple[int, str], str]]]:
        """Fields of the first lines in one text, in which a header is looked for at once, and those of each line."""
        lines = [(place, f"{_FIELD_END}{_FIELD_END.join(fields)}{_FIELD_END}") for place, fields in self.fields]
        return "".join(joined for _, joined in lines), lines

    @functools.cached_property
    def fields(self) -> list[tuple[tuple[int, str], list[str]]]:
        """Fields of each of the first lines by each delimiter that it has, with the number of the line."""
        return [
            ((number, delimiter), [" ".join(text.strip('\ufeff "').split()).casefold() for text in cells])
            for number, line in enumerate(self.head)
            for delimiter in DELIMITERS
            if len(cells := fields_of(line, delimiter)) > 1
        ]

    def table(self, place: tuple[int, str]) -> CellTable:
        """Table that begins with the header at a place that `header` found."""
        number, delimiter = place
        at = 0
        for _ in range(number):
            at = self.text.index("\n", at) + 1
        return table_of(self.text[at:], delimiter)

    def objects(self) -> list[Any]:
        """Items of a list in JSON; Refusal if the text is none."""
        if self.items is None:
            raise Refusal("it is no whole list in JSON; export it again")
        bounded(len(self.items), MAX_ROWS, "entries")
        return self.items


def _lines_of(text: str) -> list[Any] | None:
    """Items of a text with one in JSON on each line; None if the first line is none, null for another that is none."""
    lines = [line for line in text.split("\n") if line.strip()]
    bounded(len(lines), MAX_ROWS, "entries")
    first = json_of(lines[0])
    if not isinstance(first, dict):
        return None
    bounded(text.count("{") + text.count("["), _MAX_GROUPS, "objects and lists")
    return [first, *map(json_of, lines[1:])]


def _plain(value: Any) -> Any:
    """A value without the types that MongoDB writes around it, as ``{"$numberInt": "5"}``."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if not isinstance(value, dict):
        return value
    if len(value) == 1:
        [(name, inner)] = value.items()
        if name.startswith("$"):
            inner = _plain(inner)
            if name in ("$numberInt", "$numberLong", "$numberDouble", "$numberDecimal"):
                with contextlib.suppress(ValueError, TypeError):
                    number = float(inner)
                    return int(number) if number.is_integer() else number
            return inner
    return {name: _plain(inner) for name, inner in value.items()}


def _objects_of(value: Any) -> list[dict[str, Any]]:
    """Objects of a list in JSON, or of the columns of a table, as lists or by the number of the row; empty for others.

    What is no object in a list has an empty one, as a row without cells.
    """
    if isinstance(value, dict):
        columns = {name: [*own.values()] if isinstance(own, dict) else own for name, own in value.items()}
        if not all(isinstance(own, list) for own in columns.values()) or len({*map(len, columns.values())}) != 1:
            return []
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    if not isinstance(value, list) or not value or not isinstance(value[0], dict):
        return []
    return [one if isinstance(one, dict) else {} for one in value]


def cells(values: Iterable[Any]) -> pl.Series:
    """Values of JSON or XML as texts, so that what is no number is told; null for what is not there."""
    texts = (None if value is None else str(value) if isinstance(value, int | float | str) else "?" for value in values)
    return pl.Series(list(texts), dtype=pl.String)


def text_of(table: pl.DataFrame) -> str:
    """Table of another kind of file as a text, fields divided by tabs, so that it is read as any other.

    Times are written as ISO 8601 has them, and what is neither a number nor a text as a question mark.
    """
    columns = []
    for name, kind in table.schema.items():
        cell = pl.col(name)
        if isinstance(kind, pl.Datetime):
            texts = cell.dt.to_string("%Y-%m-%d %H:%M:%S" if kind.time_zone is None else "%Y-%m-%d %H:%M:%S%:z")
        elif kind.is_nested() or kind in (pl.Binary, pl.Object, pl.Duration):
            texts = pl.when(cell.is_not_null()).then(pl.lit("?"))
        else:
            texts = cell.cast(pl.String).str.replace_all(_BREAKS, " ")
        columns.append(texts.alias(" ".join(name.split())))
    return table.select(columns).write_csv(separator="\t")


def bounded(count: int, most: int, what: str, remedy: str = "divide it") -> None:
    """Refuse a file that has more of something than can be read."""
    if count > most:
        raise Refusal(f"it has {count} {what}, and at most {most} can be read; {remedy}")


def xml_of(text: str) -> ElementTree.Element:
    """Root of a text in XML; Refusal for one that is damaged, has too many elements, or defines kinds of its own."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise Refusal("it defines its own kinds of XML, which no file of a device does; give the file as it came")
    bounded(text.count("<"), _MAX_GROUPS, "elements of XML")
    try:
        return ElementTree.fromstring(text.encode(), ElementTree.XMLParser(encoding="utf-8"))
    except ElementTree.ParseError as error:
        line = error.position[0]
        raise Refusal(f"its XML breaks off or is damaged at line {line}; give the whole file") from None


def json_of(text: str) -> Any:
    """Value of a text in JSON, each text in it one that can be encoded; None if it is no JSON.

    Refusal for more values than memory is meant for: an empty object of three letters takes over 60 bytes.
    """
    bounded(text.count("{") + text.count("["), _MAX_GROUPS, "objects and lists")
    bounded(text.count(","), _MAX_VALUES, "values")
    if _SURROGATE.search(text):
        text = _ESCAPE.sub(lambda escape: r"\ufffd" if escape[1] else escape[0], text)
    try:
        return json.loads(text, parse_constant=lambda _: None)
    except (ValueError, RecursionError):  # also a number of thousands of digits
        return None


def content_of(data: bytes) -> FileText:
    """Text of a file in UTF-8, UTF-16 or Windows-1252; Refusal for what is no text."""
    document = next((name for begin, name in _DOCUMENTS.items() if data[:_BEGINNING].lstrip().startswith(begin)), None)
    if document is not None:
        raise Refusal(f"it is {document}, made for reading; export the data themselves, as CSV or JSON")
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        try:
            return _without_nul(data.decode("utf-16"), ())
        except UnicodeDecodeError:
            raise Refusal("it begins as UTF-16 and is cut off or damaged; export it again") from None
    if len(data) >= _BEGINNING and len(data) % 2 == 0:
        for nul, encoding in enumerate(("utf-16-be", "utf-16-le")):
            if set(data[nul:_BEGINNING:2]) == {0}:
                return _without_nul(data.decode(encoding, errors="replace"), ())
    try:
        return _without_nul(data.decode("utf-8-sig"), ())
    except UnicodeDecodeError:
        notes = ("The file is not in UTF-8; it was read as Windows-1252.",)
        return _without_nul(data.decode("cp1252", errors="replace"), notes)


def _without_nul(text: str, notes: tuple[str, ...]) -> FileText:
    if not text or text.isspace():
        raise Refusal(_EMPTY)
    if "\0" in text:
        raise Refusal("it is not text; give the file as it was exported, unzipped")
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    while text.startswith(_MARKS):  # a mark of the encoding, doubled or read in another one
        text = text.removeprefix(next(mark for mark in _MARKS if text.startswith(mark)))
    if _SEPARATOR_LINE.match(text):
        text = text.partition("\n")[2]
    if not text or text.isspace():
        raise Refusal(_EMPTY)
    return FileText(text, notes)


def read_bytes(path: Path) -> bytes:
    """Bytes of a file that the user named; Refusal with the mend where it cannot be read."""
    try:
        data = read_regular(path, LARGEST_BYTES)
    except OSError as error:
        raise Refusal(f"it cannot be read: {error.strerror}; give the path of a readable file") from None
    if len(data) > LARGEST_BYTES:
        raise Refusal(f"it is larger than {LARGEST_BYTES} bytes; divide it")
    return data


@dataclass(frozen=True)
class CellTable:
    """Rows of a table as texts, its blank lines left out."""

    frame: pl.DataFrame
    """Cells of each row; all are null in one that is spoilt."""
    spoilt: pl.Series
    """Reason for which nothing in a row can be used, in words what such rows are; null for a good row."""
    notes: tuple[str, ...] = ()

    def column(self, *starts: str) -> str | None:
        """Name of the first column that begins with one of the texts, in any case; None if there is none."""
        for start in starts:
            for name in self.frame.columns:
                if name.casefold().startswith(start.casefold()):
                    return name
        return None

    def texts(self, name: str | None) -> pl.Expr:
        """Cells of a column by its name in any case, without blanks around them; null for one that is not there."""
        if name is not None and name not in self.frame.columns:
            name = next((own for own in self.frame.columns if own.casefold() == name.casefold()), None)
        if name is None:
            return pl.lit(None, pl.String)
        cell = pl.col(name).str.strip_chars(' \u00a0"')
        return pl.when(cell != "").then(cell)


def table_of(text: str, delimiter: str) -> CellTable:
    """Table of a text whose first line names the columns; Refusal if it is none."""
    header, _, body = text.partition("\n")
    columns, count = header.count(delimiter) + 1, body.count("\n") + 1
    bounded(columns, _MAX_COLUMNS, "columns", "leave some out, or divide it")
    bounded(count, MAX_ROWS, "lines", "leave some out, or divide it")
    bounded(columns * count, MAX_CELLS, "cells", "leave some out, or divide it")
    body = (_BLANK_LINES.sub("\n", body) if _BLANK_LINES.search(body) else body).strip("\n")
    names = _names(header, delimiter)
    notes: tuple[str, ...] = ()
    cut = None if text.endswith("\n") else _cut_off(body, delimiter)
    if cut and body.count('"') % 2:
        body += '"'
    frame = _frame(body, delimiter, names, '"')
    quoted = '"' in body
    lines = body.split("\n") if quoted or body.count(delimiter) != (len(names) - 1) * (body.count("\n") + 1) else []
    counts = pl.Series([line.count(delimiter) for line in lines], dtype=pl.Int64)
    if frame is None or (quoted and frame.height < _whole_lines(counts, len(names) - 1)):
        quoted, frame = False, _frame(body, delimiter, names, None)
        notes = ("Quotes in the file do not close; it was read as if there were none.",)
    if frame is None:
        raise Refusal("it is no whole table; export it again")
    too_many = frame.select(pl.any_horizontal(pl.col(_EXTRA).is_not_null())).to_series()
    if not quoted and len(counts) == frame.height and counts.head(len(counts) - bool(cut)).n_unique() > 1:
        too_many |= counts > len(names) - 1  # as where a decimal comma divides a number in two
    reason = (
        pl.when(pl.lit(cut is not None) & (pl.int_range(pl.len()) == pl.len() - 1))
        .then(pl.lit(cut))
        .when(pl.lit(too_many))
        .then(pl.lit("rows with more fields than the header"))
    )
    cells = pl.col(names)
    frame = frame.with_columns(_spoilt=reason)
    maybe = pl.all_horizontal(
        cells.is_null() | (cells == "") | cells.str.starts_with(" ") | cells.str.starts_with("\t")
    )
    if frame.select(maybe.any()).item():
        frame = frame.filter(~pl.all_horizontal(cells.is_null() | (cells.str.strip_chars() == "")))
    spoilt = frame["_spoilt"]
    if spoilt.null_count() < len(spoilt):
        frame = frame.with_columns(
            pl.when(pl.col("_spoilt").is_null()).then(pl.col(name)).alias(name) for name in names
        )
    return CellTable(frame.select(names), spoilt, notes)


def _cut_off(body: str, delimiter: str) -> str | None:
    """Reason to leave out the last row of a table that does not end with a line end, which may be that of a part.

    Its last cell is compared with those above: a part of a number is another number, and one of a name another name.
    """
    *above, last = body.rsplit("\n", _COMPARED)[-_COMPARED:]
    if last.count('"') % 2 and body.count('"') % 2:
        return _CUT_OFF
    if not above:
        return None
    cell, *cells = (line.rpartition(delimiter)[2].strip(' "') for line in (last, *reversed(above)))
    fewer = last.count(delimiter) < above[-1].count(delimiter)
    part_of_name = 0 < len(cell) < len(cells[0]) and cells[0].startswith(cell)
    if fewer or part_of_name or (_NUMBER.fullmatch(cell) and _fewer_decimals(cell, cells)):
        return _CUT_OFF
    fewer_digits = cell.isdecimal() and cells[0].isdecimal() and len(cell) < len(cells[0]) and int(cell) > 0
    return "a last row that may be cut off" if fewer_digits else None


def _fewer_decimals(number: str, others: Sequence[str]) -> bool:
    """Whether a number ends with a decimal point, or has fewer decimals than each of the others has.

    Numbers that a program writes in full have many decimals, not all as many: two fewer than usual are a cut then,
    unless one in ten of the others has as few.
    """
    if not number[-1].isdecimal():
        return True
    others = [other for other in others if other]
    if len(others) < 2 or not all(map(_NUMBER.fullmatch, others)):
        return False
    own, *decimals = (len(re.split("[.,]", text)[1]) if re.search("[.,]", text) else 0 for text in (number, *others))
    usual = sorted(decimals)[len(decimals) // 2]
    as_few = sum(one <= own for one in decimals)
    return own < min(decimals) or (usual >= _IN_FULL and own <= usual - 2 and as_few <= len(decimals) / 10)


def _whole_lines(counts: pl.Series, delimiters: int) -> int:
    """Number of lines that have as many delimiters as a row of the table has: each is a row, whatever quotes say."""
    usual = min(delimiters, int(counts.median() or 0))  # type: ignore[arg-type]
    return int((counts >= max(usual, 1)).sum())


def fields_of(line: str, delimiter: str) -> list[str]:
    """Fields of a line; a delimiter within quotes divides none, unless the quotes do not close."""
    if '"' in line and not line.count('"') % 2:
        with contextlib.suppress(csv.Error):  # a field that is too long
            return next(csv.reader([line], delimiter=delimiter))
    return line.split(delimiter)


def _names(line: str, delimiter: str) -> list[str]:
    """Names of columns, each its own."""
    names: list[str] = []
    for text in fields_of(line, delimiter):
        name = " ".join(text.strip("\ufeff ").strip().strip('"').strip("\ufeff").split())
        names.append(name if name and name not in names else f"{name} ({len(names) + 1})")
    return names


def _frame(body: str, delimiter: str, names: list[str], quote: str | None) -> pl.DataFrame | None:
    every = (*names, *_EXTRA)
    if not body or body.isspace():
        return pl.DataFrame(schema=dict.fromkeys(every, pl.String()))
    header = delimiter.join(map(str, range(len(every))))  # a row may have fewer fields, but not the first line
    try:
        frame = pl.read_csv(
            io.BytesIO(f"{header}\n{body}".encode()),
            separator=delimiter,
            quote_char=quote,
            infer_schema=False,
            truncate_ragged_lines=True,
        )
    except pl.exceptions.PolarsError:
        return None
    frame.columns = list(every)
    return frame


@dataclass(frozen=True)
class _LocalisedRows:
    """Rows of such an export."""

    table: CellTable
    frame: pl.DataFrame
    """Texts of the columns, by our names."""
    glucose_unit: str | None
    is_known: bool
    """Whether its words are among the known ones."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class LocalisedTable:
    """Form of a table that an app exports in many languages, with the same columns in the same order."""

    headers: tuple[tuple[str, ...], ...]
    """Beginnings of names in the header of each known language."""
    names: Mapping[str, tuple[str, ...]]
    """Beginnings of the name of each column in the known languages, by our name."""
    places: Mapping[str, int]
    """Place of each column, by our name, for the other languages."""
    place_by_form: Callable[[FileText], tuple[int, str] | None]
    """Line and delimiter of a header whose words are unknown, by the form of its fields and of the rows below it."""
    glucose: str
    """Our name of a column whose header has the unit of glucose."""
    export: str
    """Columns that a file without such a header lacks, for the refusal."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has such a header."""
        return self._place_by_words(content) is not None or self.place_by_form(content) is not None

    def rows(self, content: FileText) -> _LocalisedRows:
        """Rows of a file; Refusal if it has no such header."""
        by_words = self._place_by_words(content)
        place = by_words or self.place_by_form(content)
        if place is None:
            raise Refusal(f"it has no header of {self.export} and so on; export it again")
        table = content.table(place)
        columns = table.frame.columns
        names = {name: table.column(*starts) for name, starts in self.names.items()}
        notes: tuple[str, ...] = ()
        by_place = {name: columns[at] if at < len(columns) else None for name, at in self.places.items()}
        if by_words is None:
            names = by_place
            notes = ("Its language is not known here: its columns were taken by their place, as in all languages.",)
        elif all(name is None or name == by_place[target] for target, name in names.items()):
            names = {target: name or by_place[target] for target, name in names.items()}
        header = (names[self.glucose] or "").casefold()
        return _LocalisedRows(
            table=table,
            frame=table.frame.select(**{name: table.texts(column) for name, column in names.items()}),
            glucose_unit=next((unit for unit in UNITS if unit in header), None),
            is_known=by_words is not None,
            notes=(*table.notes, *notes),
        )

    def _place_by_words(self, content: FileText) -> tuple[int, str] | None:
        return next((place for names in self.headers if (place := content.header(*names))), None)
