"""Folder of compiled programs. They are executable code, so it must be private, and they are checked before use.

JAX and `glucoloop._disk_cache` read and write the entries, and run any entry that they find. A person who may write
to the folder could run code and change results; so a folder that others own or can write to is not used. A list holds
the digest of each entry, written when the process that compiled it ends; an entry that is not as it is listed is
removed before it is run. This detects damage, an interrupted write and an edited entry. It does not protect against a
person with the owner's own rights, who could change this program as well.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from pathlib import Path
from typing import Final

from glucoloop._disk_cache import SUFFIX
from glucoloop.private_folder import refuse_of_others
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS

MAX_BYTES: Final = 256_000_000
"""Largest size of all entries together; the oldest are removed first."""
_ENDS: Final = ("-cache", SUFFIX)
"""Ends of the names of entries: JAX's, and those of `glucoloop._disk_cache`."""


def private_folder(folder: Path) -> None:
    """Make a folder that only this user can use; Refusal for one that others own, can write to or can replace."""
    os.makedirs(folder.parent, exist_ok=True)
    if not disk.is_folder(folder):
        os.mkdir(folder, 0o700)
    if os.name == "nt":
        return
    refuse_of_others(folder)
    if stat.S_IMODE(os.lstat(folder).st_mode) != 0o700:
        os.chmod(folder, 0o700)
    if not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))


def check_programs(folder: Path, most_bytes: int = MAX_BYTES) -> None:
    """Remove entries that are not as they are listed, and the oldest ones beyond a total size."""
    listed, result = _listed(folder), list[tuple[float, int, Path]]()
    for entry in _entries(folder):
        with contextlib.suppress(OSError):
            status = os.lstat(entry)
            if stat.S_ISREG(status.st_mode) and disk.digest(entry) == listed.get(entry.name):
                result.append((status.st_mtime, status.st_size, entry))
            elif not stat.S_ISDIR(status.st_mode):
                disk.remove(entry)
    total = 0
    for _, size, entry in sorted(result, reverse=True):
        total += size
        if total > most_bytes:
            with contextlib.suppress(OSError):
                disk.remove(entry)


def seal_programs(folder: Path) -> None:
    """List all entries, with the digests of new ones."""
    with contextlib.suppress(OSError, ValueError):
        listed = _listed(folder)
        result = {entry.name: listed.get(entry.name) or disk.digest(entry) for entry in _entries(folder)}
        if result != listed:
            disk.put_file(folder / SUMS, disk.sums_text(result))


def _entries(folder: Path) -> list[Path]:
    return [folder / name for name in disk.names(folder) if name.endswith(_ENDS)]


def _listed(folder: Path) -> dict[str, str]:
    """Digest of each entry in the list; none if it is damaged."""
    try:
        return disk.read_sums(folder)
    except (OSError, ValueError):
        return {}
