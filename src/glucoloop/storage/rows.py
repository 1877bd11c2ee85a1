"""Folder of long work whose units are rows: one table holds the results so far, and is written again as it grows."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import polars as pl

from glucoloop.refusal import Refusal
from glucoloop.schema.tables import ColumnForm, TableBounds
from glucoloop.storage import disk
from glucoloop.storage.results import parquet, read_parquet
from glucoloop.storage.resumable import Origin, ResumableFolder, Work, opened

R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class Rows(Generic[R]):
    """Description of the rows of a study."""

    file: str
    """Name of the file that holds them."""
    what: str
    """Name of the rows in messages: ``"candidates"``."""
    wanted: int
    """Number of rows that are asked for."""
    most: int
    """Number of rows above which a table is refused unread."""
    schema: Mapping[str, Any]
    """Type of each column."""
    cells: Callable[[R], Mapping[str, Any]]
    """Function that makes cells by column of a row."""
    row: Callable[[Mapping[str, Any], Sequence[R]], R]
    """Function that makes a row of cells and the rows before it; it raises ValueError if it cannot follow them."""
    width: int = 1
    """Most numbers in a cell."""
    longest_text: int = 0
    """Most bytes of the texts in a row."""
    every_s: float = 0.0
    """Time between two writings of the table."""
    unit: str = ""
    """Name of the work that progress counts, ``"patient-days"``; by default it counts rows."""
    work: Callable[[int], int] = lambda number: 1
    """Amount of work in the row of a number."""
    counted_within: bool = False
    """Whether the study itself counts the work while a row is made, rather than each row when it is done."""
    rate_over_s: float = 30.0
    """Time over which the rate of the work is taken; longer where some rows take much longer than others."""

    def amount(self, rows: int) -> int:
        """Amount of work in the first rows."""
        return sum(map(self.work, range(rows)))

    def table(self, rows: Sequence[R]) -> pl.DataFrame:
        """Table of rows, with null for a number that is not one."""
        table = pl.DataFrame([dict(self.cells(row)) for row in rows], schema=dict(self.schema))
        return table.with_columns(pl.col(pl.Float64).fill_nan(None))

    def read(self, place: Path) -> list[R]:
        """Read the rows of an earlier table; ValueError for another table."""
        bounds = TableBounds(
            least_rows=0,
            most_rows=self.most,
            columns=len(self.schema) - 1 + self.width,
            longest_text=self.longest_text,
        )
        columns = {name: ColumnForm(kind=kind, optional=kind == pl.Float64) for name, kind in self.schema.items()}
        rows: list[R] = []
        try:
            for cells in read_parquet(place, bounds, columns).iter_rows(named=True):
                rows.append(self.row(cells, rows))
        except ValueError as error:
            what = str(error) if str(place) in str(error) else f"{place} is damaged: {error}"
            raise Refusal(f"{what}; delete it and run the same command again") from None
        return rows


class RowsFolder(ResumableFolder, Generic[R]):
    """A folder of rows that this process may write to; see `rows_folder`."""

    record = "origin.json"
    in_parts = False

    def __init__(self, path: Path, work: Work, kind: Rows[R]) -> None:
        origin = Origin.current(work.keys)
        super().__init__(path, work, origin, results=kind.file, wanted=kind.wanted, unit=kind.what)
        self.kind = kind
        self.rows: list[R] = []
        self._written = 0
        self._written_s = time.monotonic()

    @property
    def done(self) -> int:
        """Number of rows that are written."""
        return self._written

    def add(self, row: R) -> None:
        """Add a row; ValueError if the table cannot be written, and the rows that are written stay."""
        self.rows.append(row)
        if time.monotonic() - self._written_s >= self.kind.every_s:
            self.write_pending()

    def write_pending(self) -> None:
        """Write the rows that are not written yet."""
        if self._written < len(self.rows):
            try:
                self.put_file(self.kind.file, parquet(self.kind.table(self.rows)))
            except BaseException:
                del self.rows[self._written :]
                raise
            self._written, self._written_s = len(self.rows), time.monotonic()

    def _read_done(self) -> None:
        place = self.path / self.kind.file
        self.rows = self.kind.read(place) if disk.is_file(place) else []
        self._written = len(self.rows)
        if self._written > self.wanted:
            raise Refusal(
                f"{self.path} holds {self._written} {self.unit}, and {self.wanted} are asked for, which is fewer; "
                "ask for more, or choose another folder with --out"
            )


def rows_folder(
    path: Path, work: Work, kind: Rows[R], *, overwrite: bool = False
) -> AbstractContextManager[RowsFolder[R]]:
    """Open the folder of work whose units are rows, new or begun, for writing; see `opened`."""
    return opened(RowsFolder(path, work, kind), overwrite=overwrite)
