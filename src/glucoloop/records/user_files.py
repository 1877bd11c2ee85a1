"""Files that a user names: one itself, those of a folder, of a ZIP, and tables of a workbook or a database."""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple

from glucoloop.records.database import is_database, tables_of
from glucoloop.records.file_text import LARGEST_BYTES, read_bytes
from glucoloop.records.workbook import is_workbook, sheets_of
from glucoloop.refusal import Refusal

ZIP: Final = b"PK\x03\x04"
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
    if not is_workbook(data) and not is_database(data):
        return [UserFile(path, data, of_many)]
    sheets = tables_of(data) if is_database(data) else sheets_of(data)
    if not sheets:
        raise Refusal("it is a workbook without a table; give the one that was exported")
    return [UserFile(path, sheet, of_many or len(sheets) > 1) for sheet in sheets]


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
