"""Reading of a file that the user named: a regular one, of a bounded size, without waiting for anybody."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

from glucoloop.refusal import Refusal

FILE, FOLDER = "a file", "a folder"
_KINDS: Final = {
    stat.S_IFREG: FILE,
    stat.S_IFDIR: FOLDER,
    stat.S_IFLNK: "a symbolic link",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_FLAGS: Final = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""Flags for opening a file without waiting for the other end of a pipe."""


def kind_of(mode: int) -> str:
    """Kind of object of a mode of the system, like ``"a pipe"``."""
    return _KINDS.get(stat.S_IFMT(mode), "something that is no file")


def read_regular(path: Path, most_bytes: int) -> bytes:
    """Contents of a regular file, and no more than one byte beyond `most_bytes`; the path may be a link to it.

    Refusal, as a clause about the file, for a folder, a pipe, a socket or a device, which is not even opened where the
    system tells its kind before; OSError where the file cannot be read.
    """
    if "\0" in str(path):
        raise Refusal("its name holds a NUL character, which no file has; leave it out")
    _check(os.stat(path).st_mode)
    descriptor = os.open(path, _FLAGS)
    with open(descriptor, "rb") as file:
        _check(os.fstat(descriptor).st_mode)
        return file.read(most_bytes + 1)


def _check(mode: int) -> None:
    kind = kind_of(mode)
    if kind == FOLDER:
        raise Refusal("it is a folder; name a file in it")
    if kind != FILE:
        raise Refusal(f"it is {kind}, not a file; write what it has into a file, and give the path of that")
