"""Workbooks of spreadsheets, XLSX and XLS: each of their tables as the text of a file."""

from __future__ import annotations

import io
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path
from typing import Final

from glucoloop._extras import needed_for
from glucoloop.records import workbook_process
from glucoloop.records.file_text import LARGEST_BYTES
from glucoloop.refusal import Refusal

_XLS: Final = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_ZIP: Final = b"PK\x03\x04"
_OFFICE: Final = "[Content_Types].xml"
_MAX_SECONDS: Final = 600.0
_SHEET: Final = "Sheet: "


def is_workbook(data: bytes) -> bool:
    """Whether the bytes of a file are those of a workbook."""
    if not data.startswith(_ZIP):
        return data.startswith(_XLS)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _OFFICE in archive.namelist()
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError):
        return False


def sheets_of(data: bytes) -> list[bytes]:
    """Tables of a workbook as texts, fields divided by tabs; the first line of each has the name of the table.

    Refusal for a workbook that is damaged, encrypted or too large, and where the library for workbooks is missing.
    """
    with needed_for("a workbook of a spreadsheet"):
        import python_calamine  # noqa: F401
    if data.startswith(_ZIP):
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
