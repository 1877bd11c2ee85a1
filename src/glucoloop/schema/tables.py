"""Table of a Parquet file that glucoloop wrote: its size and its columns are declared, and one check reads it.

See `schema.values` for why it is checked like any other input.
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
from typing import Any, Final, TypeVar

import polars as pl

from glucoloop.refusal import Refusal
from glucoloop.schema.parquet_size import parquet_size
from glucoloop.text import is_printable, one_line, printable, shown

T = TypeVar("T")

_CELL_BYTES: Final = 16
_OVERHEAD_BYTES: Final = 10_000_000
_STANDARD_ERROR: Final = 2
_ONE_AT_A_TIME: Final = threading.Lock()


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
        raise Refusal(f"its footer has no {key}")
    return texts[key]


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
