"""What became of a command's results: whether something was written, for those who are told of an error.

A command that writes a folder whole or not at all knows it; one that keeps what it has done tells about that itself.
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
    """What is known, as a part of a sentence; None if nothing is."""
    return _KNOWN.get()


@contextlib.contextmanager
def forgotten() -> Iterator[None]:
    """A command, of whose results nothing is known yet."""
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
