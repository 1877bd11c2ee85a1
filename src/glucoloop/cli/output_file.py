"""The one file that a command writes, where its result is no folder."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from glucoloop.cli.option import CommandOption, Given
from glucoloop.refusal import Refusal

OVERWRITE_FILE: Final = CommandOption("overwrite", "--overwrite", "Replace a file of that name.")


def file_to_write(given: Given) -> Path | None:
    """File that --out names, None if it names none.

    One that is there and may not be replaced, and a place where no file can be written, are refused before anything is
    computed for it.
    """
    if not given.get("out"):
        return None
    place = Path(str(given["out"]))
    if place.is_file() and not given.get("overwrite"):
        raise Refusal(f"{place} is there already; choose another file with --out, or add --overwrite to replace it")
    from glucoloop.storage.disk import check_writable

    with _refused(place):
        check_writable(place)
    return place


def write_file(place: Path, data: bytes) -> None:
    """Write a file whole or not at all; Refusal with the mend if the system does not let it."""
    from glucoloop.storage.disk import put_file

    with _refused(place):
        put_file(place, data)


@contextlib.contextmanager
def _refused(place: Path) -> Iterator[None]:
    from glucoloop.storage.disk import mend

    try:
        yield
    except OSError as error:
        ways = mend(error, "choose another place with --out")
        raise Refusal(f"{place} cannot be written: {error.strerror}; {ways}") from None
