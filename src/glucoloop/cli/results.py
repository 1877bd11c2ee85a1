"""State of a command's results, for error messages: whether files were written.

A command that writes a folder completely or not at all records it here; a resumable one prints it itself.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Final, TypeVar

T = TypeVar("T")

_KNOWN: Final[ContextVar[str | None]] = ContextVar("known", default=None)


def known() -> str | None:
    """State of the results as part of a sentence; None if it is not known."""
    return _KNOWN.get()


@contextlib.contextmanager
def forgotten() -> Iterator[None]:
    """Run a command with the state of its results not known yet."""
    token = _KNOWN.set(None)
    try:
        yield
    finally:
        _KNOWN.reset(token)


@contextlib.contextmanager
def written_whole(folder: contextlib.AbstractContextManager[T], out: Path | None) -> Iterator[T]:
    """An output folder that is written at the end of the block or not at all."""
    _KNOWN.set("nothing was written")
    with folder as entered:
        yield entered
    if out is not None:
        _KNOWN.set(f"the results are in {out}")
