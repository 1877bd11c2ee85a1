"""Table of a Parquet file, with declared size and columns if glucoloop wrote it, and one check that reads it.

See `schema.values` for why it is checked like any other input. A few kilobytes can hold gigabytes. A reader allocates
memory for a page by the page's own header, its bytes as well as its number of values, so the footer alone is not
trusted; and where memory cannot be had, polars ends the process. It tells neither, so both are read here: they are
Thrift structures in the compact protocol, of which those kinds of values are read that polars writes.

References
----------
Apache Parquet, "File Format" (https://parquet.apache.org/docs/file-format/), parquet.thrift: FileMetaData, RowGroup,
ColumnChunk, ColumnMetaData, PageHeader. Apache Thrift, "Compact protocol encoding".
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final, NamedTuple, TypeVar

import polars as pl

from glucoloop.refusal import Refusal
from glucoloop.text import is_printable, one_line, printable, shown

T = TypeVar("T")

PARQUET: Final = b"PAR1"
"""Bytes with which a Parquet file begins, and ends."""

_CELL_BYTES: Final = 16
_OVERHEAD_BYTES: Final = 10_000_000
_STANDARD_ERROR: Final = 2
_ONE_AT_A_TIME: Final = threading.Lock()


class NoMetadata(Refusal):
    """A key that the footer of a table does not have."""


@dataclass(frozen=True, kw_only=True)
class TableBounds:
    """Largest size of a table."""

    least_rows: int
    most_rows: int
    columns: int
    """Largest number of values in a row."""
    longest_text: int = 0
    """Largest size in bytes of the texts of a row."""

    @property
    def most_bytes(self) -> int:
        """Largest uncompressed size."""
        return _OVERHEAD_BYTES + self.most_rows * (self.columns * _CELL_BYTES + self.longest_text)

    def check(self, data: bytes) -> int:
        """Number of rows of a Parquet file; ValueError if its footer states a size out of bounds."""
        size = parquet_size(data)
        if not self.least_rows <= size.rows <= self.most_rows:
            wanted = f"{self.least_rows}" if self.least_rows == self.most_rows else f"at most {self.most_rows}"
            raise Refusal(f"it has {size.rows} rows, and {wanted} are expected")
        if size.bytes > self.most_bytes:
            raise Refusal(f"it unfolds to {size.bytes} bytes, and at most {self.most_bytes} are expected")
        if size.values > self.most_rows * self.columns:
            raise Refusal(f"it has {size.values} values, and at most {self.most_rows * self.columns} are expected")
        return size.rows


@dataclass(frozen=True, kw_only=True)
class ColumnForm:
    """Type and possible values of a column; the bounds themselves are possible."""

    kind: Any
    """Type of polars."""
    at_least: Any = -math.inf
    at_most: Any = math.inf
    optional: bool = True
    """Whether a cell may be null."""
    nan: bool = False
    """Whether a number may be NaN."""
    choices: tuple[str, ...] = ()
    """The possible texts, or none for any that can be printed."""

    def refuse_other(self, column: pl.Series) -> None:
        """Refuse a column of another type, or with a value that is not possible."""
        name = f"the column {shown(column.name)}"
        if column.dtype != self.kind:
            raise Refusal(f"{name} is of the type {column.dtype}, and {self.kind} is expected")
        if column.null_count() and not self.optional:
            raise Refusal(f"{name} has {column.null_count()} empty cells")
        if column.dtype == pl.String:
            others = [text for text in column.drop_nulls().unique() if self.choices and text not in self.choices]
            if others:
                raise Refusal(f"{name} has {shown(others[0])}; it should have {' or '.join(self.choices)}")
        elif column.dtype.is_numeric() or column.dtype.is_temporal():
            numbers = column.drop_nulls().to_physical()
            if column.dtype.is_float():
                if numbers.is_nan().any() and not self.nan:
                    raise Refusal(f"{name} has a value that is no number")
                numbers = numbers.drop_nans()
            low, high = (_physical(end) for end in (self.at_least, self.at_most))
            outside = numbers.filter(~numbers.is_between(low, high))
            if len(outside):
                what = "a time" if column.dtype.is_temporal() else shown(outside[0])
                raise Refusal(f"{name} has {what} outside of {self.at_least} to {self.at_most}")


def read_table(data: bytes, bounds: TableBounds, columns: Mapping[str, ColumnForm] | None = None) -> pl.DataFrame:
    """Table from the bytes of a Parquet file; Refusal, as a clause, for any that is not as it is declared.

    Without `columns` any columns will do; texts must be such that can be printed, always.
    """
    rows = bounds.check(data)
    frame: pl.DataFrame = _of_polars(lambda: pl.read_parquet(io.BytesIO(data)))
    if frame.height != rows:
        raise Refusal(f"it has {frame.height} rows, and its footer tells {rows}")
    if columns is not None and frame.columns != list(columns):
        raise Refusal(f"its columns are {shown(frame.columns)}, and {', '.join(columns)} are expected")
    for column in frame:
        if not is_printable(column.name):
            raise Refusal(f"the name of the column {shown(column.name)} has control characters")
        if column.dtype == pl.String:
            odd = [text for text in column.drop_nulls().unique() if not is_printable(text)]
            if odd:
                raise Refusal(f"the column {shown(column.name)} has {shown(odd[0])}, which has control characters")
        if columns is not None:
            columns[column.name].refuse_other(column)
    return frame


def table_metadata(data: bytes, key: str) -> str:
    """Text under a key of the footer of a Parquet file; Refusal, as a clause, where there is none."""
    parquet_size(data)  # refuses what has no footer
    texts = _of_polars(lambda: pl.read_parquet_metadata(io.BytesIO(data)))
    if key not in texts:
        raise NoMetadata(f"its footer has no {key}")
    return texts[key]


def read_any_table(data: bytes, *, most_rows: int, most_cells: int, most_bytes: int) -> pl.DataFrame:
    """Table from the bytes of a Parquet file of another program; Refusal, as a clause, if it is damaged or too large.

    Its columns are of any type, and its texts may have control characters.
    """
    size = parquet_size(data)
    for number, most, what in (
        (size.rows, most_rows, "rows"),
        (size.values, most_cells, "values"),
        (size.bytes, most_bytes, "bytes"),
    ):
        if number > most:
            raise Refusal(f"it has {number} {what}, and at most {most} can be read")
    return _of_polars(lambda: pl.read_parquet(io.BytesIO(data)))


def _physical(end: Any) -> Any:
    return pl.Series([end], dtype=pl.Datetime("us")).to_physical()[0] if isinstance(end, datetime) else end


def _of_polars(read: Callable[[], T]) -> T:
    """Result of a reading by polars; Refusal for a file that it cannot read, of which it then prints nothing."""
    try:
        with _without_words_of_a_panic():
            return read()
    except (pl.exceptions.PolarsError, OSError, OverflowError, ValueError) as error:
        raise Refusal(f"it is damaged: {printable(one_line(error))}") from None
    except pl.exceptions.PanicException:
        raise Refusal("it is damaged: a page does not hold what its footer tells") from None


@contextlib.contextmanager
def _without_words_of_a_panic() -> Iterator[None]:
    """Leave out what is written to standard error if the block ends in a panic.

    Rust prints a panic to the descriptor before Python has the exception, and nobody can catch it there. What is
    written while the block succeeds follows after it.
    """
    with _ONE_AT_A_TIME, contextlib.ExitStack() as stack:
        try:
            before = os.dup(_STANDARD_ERROR)
        except OSError:  # closed
            yield
            return
        stack.callback(os.close, before)
        words = stack.enter_context(tempfile.TemporaryFile())
        os.dup2(words.fileno(), _STANDARD_ERROR)
        try:
            yield
        except pl.exceptions.PanicException:
            words.truncate(0)
            raise
        finally:
            os.dup2(before, _STANDARD_ERROR)
            words.seek(0)
            for line in words:
                os.write(_STANDARD_ERROR, line)


_LONGEST_VARINT: Final = 10
# Fields of FileMetaData, RowGroup, ColumnChunk, ColumnMetaData and PageHeader.
_ROWS, _GROUPS = 3, 4
_COLUMNS, _GROUP_ROWS = 1, 3
_META = 3
_VALUES, _UNFOLDED, _FOLDED, _DATA_AT, _DICTIONARY_AT = 5, 6, 7, 9, 11
_PAGE_KIND, _PAGE_UNFOLDED, _PAGE_FOLDED = 1, 2, 3
_HEADERS: Final = {0: 5, 2: 7, 3: 8}
"""Field of the header of its own that a page of each kind has; the first field there is its number of values."""
_DICTIONARY: Final = 2
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _BINARY, _LIST, _STRUCT = 1, 2, 3, 4, 5, 6, 8, 9, 12


class _ParquetSize(NamedTuple):
    """Size of a table."""

    rows: int
    bytes: int
    """Bytes of all pages, uncompressed, by the footer or their own headers: whichever is more."""
    values: int
    """Number of values of all columns, likewise; a list has several."""


def parquet_size(data: bytes) -> _ParquetSize:
    """Size of a table before it is read; ValueError if the bytes are no Parquet file."""
    if len(data) < 12 or data[:4] != PARQUET or data[-4:] != PARQUET:
        raise Refusal("it is not a Parquet file")
    length = int.from_bytes(data[-8:-4], "little")
    if length > len(data) - 12:
        raise Refusal("its footer is longer than the file")
    try:
        meta = _Thrift(data[-8 - length : -8]).struct()
        groups = meta.get(_GROUPS, [])
        columns = [column[_META] for group in groups for column in group.get(_COLUMNS, [])]
        sizes = _UNFOLDED, _FOLDED, _VALUES
        unfolded, folded, values = ([int(column[field]) for column in columns] for field in sizes)
        rows, of_groups = int(meta[_ROWS]), [int(group[_GROUP_ROWS]) for group in groups]
        if min(folded, default=0) < 0 or sum(folded) > len(data):  # pages in common would be walked again and again
            raise ValueError
        result = [_of_pages(data, column) for column in columns]
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, RecursionError):
        raise Refusal("its footer or the header of a page is damaged") from None
    if rows != sum(of_groups) or min([*of_groups, *unfolded, *values], default=0) < 0:
        raise Refusal("its footer contradicts itself")
    footer = zip(unfolded, values, strict=True)
    by_column = [tuple(map(max, *both)) for both in zip(footer, result, strict=True)]
    return _ParquetSize(rows, sum(size for size, _ in by_column), sum(count for _, count in by_column))


def _of_pages(data: bytes, column: dict[int, Any]) -> tuple[int, int]:
    """Bytes of a column's pages, uncompressed, and number of its values, as the header of each page says."""
    start, folded = column.get(_DICTIONARY_AT, column[_DATA_AT]), column[_FOLDED]
    if not len(PARQUET) <= start <= min(column[_DATA_AT], len(data) - folded):
        raise ValueError
    pages, unfolded, values = _Thrift(data[start : start + folded]), 0, 0
    while pages.tell() < folded:
        header = pages.struct()
        pages.take(header[_PAGE_FOLDED])
        kind, count = header[_PAGE_KIND], header[_HEADERS[header[_PAGE_KIND]]][1]
        if min(count, header[_PAGE_UNFOLDED]) < 0 or (kind == _DICTIONARY and count > header[_PAGE_UNFOLDED]):
            raise ValueError
        values += 0 if kind == _DICTIONARY else count
        unfolded += header[_PAGE_UNFOLDED]
    return unfolded, values


class _Thrift(io.BytesIO):
    """Values in the compact protocol, one after the other; a structure becomes a dictionary by field number."""

    def take(self, size: int) -> bytes:
        """The next bytes; ValueError if there are fewer than that."""
        result = self.read(max(size, 0))
        if len(result) != size:
            raise ValueError
        return result

    def struct(self) -> dict[int, Any]:
        result: dict[int, Any] = {}
        field = 0
        while head := self.take(1)[0]:
            step, kind = head >> 4, head & 15
            field = field + step if step else self._signed()
            result[field] = kind == _TRUE if kind in (_TRUE, _FALSE) else self._value(kind)
        return result

    def _value(self, kind: int) -> Any:
        if kind in (_TRUE, _FALSE, _BYTE):  # in a list each takes a byte
            return self.take(1)[0]
        if kind in (_I16, _I32, _I64):
            return self._signed()
        if kind == _BINARY:
            return self.take(self._varint())
        if kind == _LIST:
            head = self.take(1)[0]
            size = head >> 4 if head >> 4 < 15 else self._varint()
            return [self._value(head & 15) for _ in range(size)]  # each takes a byte at least, so they end
        if kind == _STRUCT:
            return self.struct()
        raise ValueError

    def _varint(self) -> int:
        value = 0
        for position in range(_LONGEST_VARINT):
            byte = self.take(1)[0]
            value |= (byte & 127) << 7 * position
            if byte < 128:
                return value
        raise ValueError

    def _signed(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)
