"""Lock that allows one run at a time in a folder."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from glucoloop.refusal import Refusal
from glucoloop.storage import disk

LOCK: Final = "lock"
_DIGITS: Final = 20


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder during the block; the lock of a dead process is free.

    Raises
    ------
    ValueError
        If another run holds it, or its name belongs to something that is not a file.
    """
    if not disk.can_lock():
        yield
        return
    place = folder / LOCK
    with disk.flocked(place, create=True) as descriptor:
        if descriptor is None:
            raise Refusal(
                f"another run writes to {folder}{_whose(place)}; wait for it, or choose another folder with --out"
            )
        try:
            disk.overwrite(descriptor, f"{os.getpid()}\n".encode())
            yield
        finally:
            # While the lock is held, so that nobody else's is removed.
            with contextlib.suppress(OSError):
                disk.remove(place)


def _whose(place: Path) -> str:
    try:
        by = disk.read_bytes(place, _DIGITS).decode().strip()
    except (OSError, ValueError):
        return ""
    return f" (process {by})" if by.isdecimal() else ""
