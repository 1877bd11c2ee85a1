"""``glucoloop cache``: what is kept from one process for the next."""

from __future__ import annotations

import contextlib
from typing import Final

from glucoloop import _disk_cache
from glucoloop.cli.command import JSON, Command, CommandOption, Given
from glucoloop.cli.screen import print_text, print_value
from glucoloop.private_folder import refuse_of_others
from glucoloop.refusal import Refusal

HELP: Final = (
    "Say where compiled programs are kept for the next start and how large they are, or remove them.\n\n"
    f"The folder keeps at most {_disk_cache.MAX_BYTES / 1e6:.0f} MB. The variable {_disk_cache.VARIABLE} names another "
    "one, or is off to keep nothing. Without programs a start takes longer; results are the same.\n\n"
    "  glucoloop cache --clear"
)


def _cache(typed: Given) -> None:
    """Print the folder, the number of its files and their size, once they are removed if that is asked for."""
    folder = _disk_cache.cache_folder()
    if folder is None:
        raise Refusal(f"nothing is kept, since {_disk_cache.VARIABLE} is off; leave the variable out")
    refuse_of_others(folder)
    entries = _disk_cache.entries(folder)
    if typed.get("clear"):
        for place, _ in entries:
            with contextlib.suppress(FileNotFoundError):  # another process removed it
                place.unlink()
    size = sum(status.st_size for _, status in entries)
    if typed.get("json"):
        from glucoloop.storage.files import with_version

        removed = bool(typed.get("clear"))
        print_value(
            with_version({"folder": str(folder), "files": len(entries), "size_bytes": size, "removed": removed})
        )
        return
    number = f"{len(entries)} file{'' if len(entries) == 1 else 's'} of {size / 1e6:.1f} MB"
    print_text(f"{folder}: {number}{' removed' if typed.get('clear') else ''}.")


CACHE: Final = Command(
    "cache",
    HELP,
    (CommandOption("clear", "--clear", "Remove the files."), JSON),
    _cache,
)
