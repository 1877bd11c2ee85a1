"""One run at a time in a folder."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

try:
    import fcntl
except ImportError:  # Windows, where a folder is not locked
    fcntl = None  # type: ignore[assignment]

LOCK: Final = "lock"


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder while the block runs; the lock of a process that died is free.

    Raises
    ------
    ValueError
        If another run holds it.
    """
    if fcntl is None:
        yield
        return
    place = folder / LOCK
    with _taken(place, folder):
        try:
            yield
        finally:
            # While the lock is held, so that nobody else's is removed.
            with contextlib.suppress(OSError):
                place.unlink()


@contextlib.contextmanager
def _taken(place: Path, folder: Path) -> Iterator[None]:
    while True:
        with place.open("a+", encoding="utf-8") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                file.seek(0)
                by = file.read(20).strip()
                raise ValueError(
                    f"another run writes to {folder}{f' (process {by})' if by else ''}; "
                    "wait for it, or choose another folder with --out"
                ) from None
            if not _is_still(place, file):
                continue  # the one who held it has removed it
            file.truncate(0)
            file.write(f"{os.getpid()}\n")
            file.flush()
            yield
            return


def _is_still(place: Path, file: Any) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), place.stat())
    except OSError:
        return False
