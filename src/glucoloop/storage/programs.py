"""Check of what JAX keeps in the folder of compiled programs, which is executable code, before it is used.

JAX reads and writes entries, and runs any entry that it finds. `glucoloop._disk_cache` makes the folder private and
keeps it small. Here a list holds the digest of each of JAX's entries, written when the process that compiled it ends;
an entry that is not as it is listed is removed before it is run. This detects damage, an interrupted write and an
edited entry. It does not protect against a person with the owner's own rights, who could change this program as well.
"""

from __future__ import annotations

import contextlib
import os
import stat
from pathlib import Path
from typing import Final

from glucoloop._disk_cache import remove_oldest
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS

_JAX: Final = "-cache"
"""End of the names of JAX's entries."""


def check_programs(folder: Path) -> None:
    """Remove entries of JAX that are not as they are listed, and the oldest ones of all beyond a total size."""
    listed = _listed(folder)
    for entry in _entries(folder):
        with contextlib.suppress(OSError):
            mode = os.lstat(entry).st_mode
            whole = stat.S_ISREG(mode) and disk.digest(entry) == listed.get(entry.name)
            if not whole and not stat.S_ISDIR(mode):
                disk.remove(entry)
    remove_oldest(folder)


def seal_programs(folder: Path) -> None:
    """List all entries, with the digests of new ones."""
    with contextlib.suppress(OSError, ValueError):
        listed = _listed(folder)
        result = {entry.name: listed.get(entry.name) or disk.digest(entry) for entry in _entries(folder)}
        if result != listed:
            disk.put_file(folder / SUMS, disk.sums_text(result))


def _entries(folder: Path) -> list[Path]:
    return [folder / name for name in disk.names(folder) if name.endswith(_JAX)]


def _listed(folder: Path) -> dict[str, str]:
    """Digest of each entry in the list; none if it is damaged."""
    try:
        return disk.read_sums(folder)
    except (OSError, ValueError):
        return {}
