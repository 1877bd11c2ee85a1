"""Uncompressed size of a Parquet file before it is read: a few kilobytes can hold gigabytes.

A reader allocates memory for a page by the page's own header, its bytes as well as its number of values, so the footer
alone is not trusted; and where memory cannot be had, polars ends the process. It tells neither, so both are read here:
they are Thrift structures in the compact protocol, of which those kinds of values are read that polars writes.

References
----------
Apache Parquet, "File Format" (https://parquet.apache.org/docs/file-format/), parquet.thrift: FileMetaData, RowGroup,
ColumnChunk, ColumnMetaData, PageHeader. Apache Thrift, "Compact protocol encoding".
"""

from __future__ import annotations

import io
from typing import Any, Final, NamedTuple

from glucoloop.refusal import Refusal

_MAGIC: Final = b"PAR1"
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


class ParquetSize(NamedTuple):
    """Size of a table."""

    rows: int
    bytes: int
    """Bytes of all pages, uncompressed, by the footer or their own headers: whichever is more."""
    values: int
    """Number of values of all columns, likewise; a list has several."""


def parquet_size(data: bytes) -> ParquetSize:
    """Size of a table before it is read; ValueError if the bytes are no Parquet file."""
    if len(data) < 12 or data[:4] != _MAGIC or data[-4:] != _MAGIC:
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
    return ParquetSize(rows, sum(size for size, _ in by_column), sum(count for _, count in by_column))


def _of_pages(data: bytes, column: dict[int, Any]) -> tuple[int, int]:
    """Bytes of a column's pages, uncompressed, and number of its values, as the header of each page says."""
    start, folded = column.get(_DICTIONARY_AT, column[_DATA_AT]), column[_FOLDED]
    if not len(_MAGIC) <= start <= min(column[_DATA_AT], len(data) - folded):
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
