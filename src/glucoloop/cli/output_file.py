"""The one file that a command writes, where its result is no folder."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from glucoloop.cli.option import CommandOption, Given
from glucoloop.refusal import Refusal

OVERWRITE_FILE: Final = CommandOption("overwrite", "--overwrite", "Replace a file of that name.")


def file_to_write(given: Given) -> Path | None:
    """File that --out names, None if it names none; Refusal for one that is there and may not be replaced."""
    if not given.get("out"):
        return None
    place = Path(str(given["out"]))
    if place.is_file() and not given.get("overwrite"):
        raise Refusal(f"{place} is there already; choose another file with --out, or add --overwrite to replace it")
    return place


def write_file(place: Path, data: bytes) -> None:
    """Write a file whole or not at all; Refusal with the mend if the system does not let it."""
    from glucoloop.storage.disk import mend, put_file

    try:
        put_file(place, data)
    except OSError as error:
        ways = mend(error, "choose another place with --out")
        raise Refusal(f"{place} cannot be written: {error.strerror}; {ways}") from None
