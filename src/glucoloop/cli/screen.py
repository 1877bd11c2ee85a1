"""What a person sees while a command works: on standard error, so that results alone are on standard output."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable, Iterator


@contextlib.contextmanager
def stage(text: str) -> Iterator[None]:
    """A line that moves while the block works; nothing where nobody watches."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(f"{text} ..."):
        yield


def note(texts: Iterable[str]) -> None:
    """Notes, one line each."""
    for text in texts:
        print(text, file=sys.stderr)


def show(table: object) -> None:
    """A table on standard output; piped, it is plain text and as wide as it needs to be."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else 200
    Console(width=width, highlight=False, file=sys.stdout).print(table)
