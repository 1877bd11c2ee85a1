"""Uncompressed size of a Parquet file from its footer: a few kilobytes can hold gigabytes.

The footer is a Thrift structure in the compact protocol. Only the sizes are read from it.

References
----------
Apache Parquet, "File Format" (https://parquet.apache.org/docs/file-format/), parquet.thrift: FileMetaData, RowGroup,
ColumnChunk, ColumnMetaData. Apache Thrift, "Compact protocol encoding".
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, Final

_MAGIC: Final = b"PAR1"
_DEEPEST: Final = 16
_LONGEST_VARINT: Final = 10
# Fields of FileMetaData, RowGroup, ColumnChunk and ColumnMetaData.
_ROWS, _GROUPS = 3, 4
_COLUMNS, _GROUP_ROWS = 1, 3
_META = 3
_UNFOLDED: Final = 6
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)


@dataclass(frozen=True)
class ParquetSize:
    """Size of a file according to its footer."""

    rows: int
    bytes: int
    """Size of all pages, uncompressed."""


def parquet_size(data: bytes) -> ParquetSize:
    """Size of a table before it is read.

    Raises
    ------
    ValueError
        If the bytes are no Parquet file.
    """
    if len(data) < 12 or data[:4] != _MAGIC or data[-4:] != _MAGIC:
        raise ValueError("it is no Parquet file")
    (length,) = struct.unpack("<I", data[-8:-4])
    if length > len(data) - 12:
        raise ValueError("its footer is longer than the file")
    try:
        meta = _Reader(data[-8 - length : -8]).struct()
        groups = meta.get(_GROUPS, [])
        columns = [column for group in groups for column in group.get(_COLUMNS, [])]
        unfolded = [int(column[_META][_UNFOLDED]) for column in columns]
        rows, of_groups = int(meta[_ROWS]), [int(group[_GROUP_ROWS]) for group in groups]
    except (KeyError, IndexError, TypeError, AttributeError, struct.error, ValueError):
        raise ValueError("its footer is damaged") from None
    if rows != sum(of_groups) or min([*of_groups, *unfolded], default=0) < 0:
        raise ValueError("its footer contradicts itself")
    return ParquetSize(rows=rows, bytes=sum(unfolded))


class _Reader:
    """Reader of the compact protocol; a structure becomes a dictionary by field number."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        found: dict[int, Any] = {}
        field = 0
        while head := self._byte():
            step, kind = head >> 4, head & 15
            field = field + step if step else self._zigzag()
            found[field] = kind == _TRUE if kind in (_TRUE, _FALSE) else self._value(kind, depth)
        return found

    def _value(self, kind: int, depth: int) -> Any:
        if depth > _DEEPEST:
            raise ValueError
        if kind in (_TRUE, _FALSE, _BYTE):  # in a list each takes a byte
            return self._byte()
        if kind in (_I16, _I32, _I64):
            return self._zigzag()
        if kind == _DOUBLE:
            return struct.unpack("<d", self._take(8))[0]
        if kind == _BINARY:
            return self._take(self._varint())
        if kind in (_LIST, _SET):
            head = self._byte()
            size = head >> 4 if head >> 4 < 15 else self._varint()
            return [self._value(head & 15, depth + 1) for _ in range(self._of_data(size))]
        if kind == _MAP:
            size = self._of_data(self._varint())
            kinds = self._byte() if size else 0
            return [(self._value(kinds >> 4, depth + 1), self._value(kinds & 15, depth + 1)) for _ in range(size)]
        if kind == _STRUCT:
            return self.struct(depth + 1)
        raise ValueError

    def _of_data(self, size: int) -> int:
        """A number of elements, refused if there are fewer bytes left than elements."""
        if size > len(self._data) - self._at:
            raise ValueError
        return size

    def _byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]

    def _take(self, size: int) -> bytes:
        self._at += self._of_data(size)
        return self._data[self._at - size : self._at]

    def _varint(self) -> int:
        value = 0
        for position in range(_LONGEST_VARINT):
            byte = self._byte()
            value |= (byte & 127) << 7 * position
            if byte < 128:
                return value
        raise ValueError

    def _zigzag(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)
