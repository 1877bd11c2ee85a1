"""Folder of compiled programs. They are executable code, so it must be private, and they are checked before use.

JAX reads and writes the entries, and runs any entry that it finds. A person who may write to the folder could run code
and change results; so a folder that others own or can write to is not used. Beside each entry stands its digest,
written when the process that compiled it ends; an entry without a matching digest is removed before JAX sees it. This
detects damage, an interrupted write and an edited entry. It does not protect against a person with the owner's own
rights, who could change this program as well.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from pathlib import Path
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.storage import disk

MOST_BYTES: Final = 256_000_000
"""Largest size of all entries together; the oldest are removed first."""
_ENTRY: Final = "-cache"
_DIGEST: Final = ".sha256"
_DIGEST_BYTES: Final = 64
_OTHERS_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH


def private_folder(folder: Path) -> None:
    """Make a folder that only this user can use; ValueError for one that another user owns or may write to."""
    os.makedirs(folder.parent, exist_ok=True)
    if not disk.is_folder(folder):
        os.mkdir(folder, 0o700)
    if os.name == "nt":
        return
    above, found = os.stat(folder.parent).st_mode, os.lstat(folder)
    if found.st_uid != os.getuid():
        raise Refusal(f"{folder} belongs to another user")
    if above & _OTHERS_WRITE and not above & stat.S_ISVTX:
        raise Refusal(f"others can put another folder in the place of {folder}")
    if found.st_mode & _OTHERS_WRITE:
        raise Refusal(f"others can write to {folder}; empty it and run chmod 700 on it")
    if stat.S_IMODE(found.st_mode) != 0o700:
        os.chmod(folder, 0o700)
    if not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))


def check_programs(folder: Path, most_bytes: int = MOST_BYTES) -> None:
    """Remove entries that were changed, and the oldest ones beyond a total size."""
    found: list[tuple[float, int, Path]] = []
    entries = {folder / name.removesuffix(_DIGEST) for name in disk.names(folder)}
    for entry in filter(lambda entry: entry.name.endswith(_ENTRY), entries):
        with contextlib.suppress(OSError):
            if _is_whole(entry):
                status = os.lstat(entry)
                found.append((status.st_mtime, status.st_size, entry))
            else:
                _remove(entry)
    total = 0
    for _, size, entry in sorted(found, reverse=True):
        total += size
        if total > most_bytes:
            with contextlib.suppress(OSError):
                _remove(entry)


def seal_programs(folder: Path) -> None:
    """Write the digests of new entries."""
    with contextlib.suppress(OSError, ValueError):
        for name in disk.names(folder):
            entry = folder / name
            if name.endswith(_ENTRY) and not disk.kind(_digest_of(entry)):
                with contextlib.suppress(OSError, ValueError):
                    disk.put_file(_digest_of(entry), disk.digest(entry).encode())


def _is_whole(entry: Path) -> bool:
    try:
        return disk.read_bytes(_digest_of(entry), _DIGEST_BYTES) == disk.digest(entry).encode()
    except (OSError, ValueError):
        return False


def _remove(entry: Path) -> None:
    for path in (entry, _digest_of(entry)):
        if disk.kind(path) not in ("", "a folder"):
            disk.remove(path)


def _digest_of(entry: Path) -> Path:
    return entry.with_name(f"{entry.name}{_DIGEST}")
