"""Files and folders that are there whole or not at all, whatever happens while they are written.

What is in the making has a name that begins with a dot and ends in ``.part``; it is on the disk before it is renamed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from glucoloop.storage.folder import SUMS

PART: Final = ".part"


def in_the_making(name: str) -> bool:
    """Whether a file or folder of this name was left by a run that was cut short."""
    return name.startswith(".") and name.endswith(PART)


def put_file(place: Path, data: bytes) -> None:
    """Put a file in its place, taking that of an earlier one."""
    part = place.with_name(f".{place.name}{PART}")
    _write(part, data)
    part.replace(place)
    _sync(place.parent)


def put_folder(place: Path, files: Mapping[str, bytes]) -> None:
    """Put a folder in its place, which must be free, with its files and the list of their digests."""
    part = place.with_name(f".{place.name}{PART}")
    remove(part)
    part.mkdir()
    try:
        for name, data in files.items():
            _write(part / name, data)
        _write(part / SUMS, sums_text({name: hashlib.sha256(data).hexdigest() for name, data in files.items()}))
        _sync(part)
        part.rename(place)
    except BaseException:
        remove(part)
        raise
    _sync(place.parent)


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def sums_text(digests: Mapping[str, str]) -> bytes:
    """The list that ``sha256sum -c`` checks."""
    return "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items())).encode()


def read_sums(folder: Path) -> dict[str, str]:
    """Name -> digest from the list in a folder; empty if there is none that can be read."""
    try:
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return {}
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines) if name}


def digest(file: Path) -> str:
    """SHA-256 of a file; the empty text if it cannot be read."""
    try:
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError:
        return ""


def _write(place: Path, data: bytes) -> None:
    try:
        with place.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except BaseException:
        with contextlib.suppress(OSError):
            place.unlink(missing_ok=True)
        raise


def _sync(folder: Path) -> None:
    """Make a renaming last; Windows does so by itself and opens no folders."""
    if os.name == "nt":
        return
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)
