"""Files that a user names: one itself, those of a folder or a ZIP, and tables of a workbook, a database or Parquet."""

from __future__ import annotations

import io
import sqlite3
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple

import polars as pl

from glucoloop.records import workbook_process
from glucoloop.records.file_text import LARGEST_BYTES, MAX_CELLS, MAX_ROWS, cells, read_bytes, text_of
from glucoloop.records.record import is_parquet_record
from glucoloop.refusal import Refusal, needed_for
from glucoloop.schema.tables import PARQUET, read_any_table

_GZIP: Final = b"\x1f\x8b"
_WITH_HEADER: Final = zlib.MAX_WBITS | 16
"""Form of compressed bytes that begin with gzip's header."""
_MAX_FILES: Final = 1000


class UserFile(NamedTuple):
    """Bytes of a file, with the path by which messages name it."""

    path: Path
    data: bytes
    of_many: bool = False
    """Whether it came with others, in a folder, a ZIP or a workbook, some of which may be of another kind."""


def files_of(path: Path) -> list[UserFile]:
    """Files at a path; Refusal where there are none, or more than are meant for one person."""
    if path.is_dir():
        inside = sorted(
            file
            for file in path.rglob("*")
            if file.is_file() and not any(part.startswith(".") for part in file.relative_to(path).parts)
        )
        if not inside:
            raise Refusal("it is a folder without files; give one with the files of a person")
        if len(inside) > _MAX_FILES:
            raise Refusal(f"it is a folder of {len(inside)} files, and at most {_MAX_FILES} can be read; divide it")
        return [file._replace(of_many=True) for one in inside for file in files_of(one)]
    data = read_bytes(path)
    if data.startswith(ZIP) and not is_workbook(data):
        return [file for place, inner in _unpacked(path, data) for file in _opened(place, inner, of_many=True)]
    return _opened(path, data, of_many=False)


def _opened(path: Path, data: bytes, *, of_many: bool) -> list[UserFile]:
    """A file, or the tables of a workbook or a database; what is compressed is unpacked."""
    if data.startswith(_GZIP):
        data = _decompressed(data)
    if data.startswith(ZIP) and not is_workbook(data):
        raise Refusal("it is a ZIP within another file; unpack that, and give what is in it")
    if data.startswith(PARQUET) and not is_parquet_record(data):
        return [UserFile(path, _text_of_parquet(data), of_many)]
    if not is_workbook(data) and not _is_database(data):
        return [UserFile(path, data, of_many)]
    sheets = _tables_of(data) if _is_database(data) else _sheets_of(data)
    if not sheets:
        raise Refusal("it is a workbook without a table; give the one that was exported")
    return [UserFile(path, sheet, of_many or len(sheets) > 1) for sheet in sheets]


def _text_of_parquet(data: bytes) -> bytes:
    """Table of a Parquet file as a text, fields divided by tabs; Refusal for one that is damaged or too large."""
    try:
        table = read_any_table(data, most_rows=MAX_ROWS, most_cells=MAX_CELLS, most_bytes=LARGEST_BYTES)
    except Refusal as error:
        raise Refusal(f"it is a Parquet file that cannot be read: {error}", "write it again, or as CSV") from None
    return text_of(table).encode()


def _decompressed(data: bytes) -> bytes:
    """Bytes of a file that gzip compressed, of bounded size."""
    try:
        result = zlib.decompressobj(_WITH_HEADER).decompress(data, LARGEST_BYTES + 1)
    except zlib.error:
        raise Refusal("it is compressed by gzip and damaged; export it again") from None
    if len(result) > LARGEST_BYTES:
        raise Refusal(f"it unfolds to more than {LARGEST_BYTES} bytes; divide it")
    return result


def _unpacked(path: Path, data: bytes) -> list[tuple[Path, bytes]]:
    """Files of a ZIP, of bounded number and size."""
    result: list[tuple[Path, bytes]] = []
    left = LARGEST_BYTES
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
            if len(names) > _MAX_FILES:
                raise Refusal(f"it has {len(names)} files, and at most {_MAX_FILES} can be read; divide it")
            for name in sorted(names):
                place = Path(*PurePosixPath(name.lstrip("/")).parts)
                if name.endswith("/") or any(part.startswith((".", "__MACOSX")) for part in place.parts):
                    continue
                with archive.open(name) as file:
                    inside = file.read(left + 1)
                left -= len(inside)
                if left < 0:
                    raise Refusal(f"it unfolds to more than {LARGEST_BYTES} bytes; divide it")
                result.append((path / place, inside))
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError, ValueError) as error:
        if isinstance(error, Refusal):
            raise
        raise Refusal("it is a ZIP that is damaged or encrypted; unpack it, and give its folder") from None
    if not result:
        raise Refusal("it is an empty ZIP; give the one that was exported")
    return result


XDRIP_TABLES: Final = {
    "BgReadings": ("timestamp", "calculated_value", "dg_mgdl"),
    "Treatments": ("timestamp", "eventType", "carbs", "insulin", "insulinJSON"),
    "BloodTest": ("timestamp", "mgdl"),
}
"""Columns that are read of each table of xDrip's database."""
_SQLITE: Final = b"SQLite format 3\0"
_STEPS_AT_ONCE, _MAX_STEPS = 1_000_000, 2_000
"""Steps of SQLite's machine, in thousands of millions at most, after which a query is given up."""


def _is_database(data: bytes) -> bool:
    """Whether the bytes of a file are those of a database of SQLite."""
    return data.startswith(_SQLITE)


def _tables_of(data: bytes) -> list[bytes]:
    """Known tables of a database as texts, fields divided by tabs; Refusal for a database that has none of them."""
    steps = 0

    def too_long() -> bool:
        nonlocal steps
        steps += 1
        return steps > _MAX_STEPS

    result: list[bytes] = []
    try:
        with sqlite3.connect(":memory:") as database:
            database.deserialize(data)
            database.execute("PRAGMA trusted_schema = OFF")
            database.set_progress_handler(too_long, _STEPS_AT_ONCE)
            for name, columns in XDRIP_TABLES.items():
                if not database.execute(
                    "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?", (name,)
                ).fetchone():
                    continue
                there = {row[1] for row in database.execute(f"PRAGMA table_info({name})")}
                chosen = ", ".join(f'"{column}"' if column in there else "NULL" for column in columns)
                rows = database.execute(f"SELECT {chosen} FROM {name} LIMIT {MAX_ROWS + 1}").fetchall()
                table = pl.DataFrame({column: cells(row[at] for row in rows) for at, column in enumerate(columns)})
                result.append(text_of(table).encode())
    except (sqlite3.Error, UnicodeDecodeError, OverflowError) as error:
        raise Refusal("it is a database that is damaged; export it again") from error
    if not result:
        raise Refusal(
            "it is a database without a table of xDrip, which is the only app whose database is known; "
            "export its readings as CSV"
        )
    return result


_XLS: Final = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
ZIP: Final = b"PK\x03\x04"
_OFFICE: Final = "[Content_Types].xml"
_MAX_SECONDS: Final = 600.0
_SHEET: Final = "Sheet: "


def is_workbook(data: bytes) -> bool:
    """Whether the bytes of a file are those of a workbook."""
    if not data.startswith(ZIP):
        return data.startswith(_XLS)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _OFFICE in archive.namelist()
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError):
        return False


def _sheets_of(data: bytes) -> list[bytes]:
    """Tables of a workbook as texts, fields divided by tabs; the first line of each has the name of the table.

    Refusal for a workbook that is damaged, encrypted or too large, and where the library for workbooks is missing.
    """
    with needed_for("a workbook of a spreadsheet"):
        import python_calamine  # noqa: F401
    if data.startswith(ZIP):
        _refuse_bombs(data)
    command = [sys.executable, "-P", str(Path(workbook_process.__file__))]
    try:
        run = subprocess.run(command, input=data, capture_output=True, timeout=_MAX_SECONDS, check=False)
        text = run.stdout.decode()
    except (subprocess.TimeoutExpired, OSError, UnicodeDecodeError):
        text = ""
    else:
        text = text if run.returncode == 0 else ""
    sheets = [sheet.lstrip("\n") for sheet in text.split(workbook_process.SHEET_END)][:-1]
    if not sheets:
        raise Refusal(
            "it is a workbook that is damaged, encrypted or too large; "
            "open it in a spreadsheet, save its tables as CSV, and give those"
        )
    return [sheet.encode() for sheet in sheets if sheet.partition("\n")[2].strip()]


def sheet_name(first_line: str) -> str:
    """Name of the table of which a text begins with a line; empty for a text that comes from no workbook."""
    return first_line.removeprefix(_SHEET).strip() if first_line.startswith(_SHEET) else ""


def _refuse_bombs(data: bytes) -> None:
    """Refuse a workbook that unfolds to more than can be read."""
    left = LARGEST_BYTES
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in archive.namelist():
                with archive.open(name) as part:
                    while block := part.read(1 << 20):
                        left -= len(block)
                        if left < 0:
                            raise Refusal(f"it unfolds to more than {LARGEST_BYTES} bytes; divide it")
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError, zlib.error) as error:
        raise Refusal("it is a workbook that is damaged or encrypted; save it again") from error
