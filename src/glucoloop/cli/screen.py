"""What a person sees while a command works: on standard error, so that results alone are on standard output."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterable, Iterator

from glucoloop.cli.interrupts import leave_if_asked


@contextlib.contextmanager
def stage(text: str) -> Iterator[None]:
    """A line that moves while the block works; nothing where nobody watches."""
    with _line(text):
        yield
    leave_if_asked()


@contextlib.contextmanager
def stages(first: str) -> Iterator[Callable[[str], None]]:
    """A line that moves while the block works, and says what the block last told it to have done."""
    with _line(first) as update:

        def done(what: str) -> None:
            leave_if_asked()
            update(f"Done: {what} ...")

        yield done


@contextlib.contextmanager
def _line(text: str) -> Iterator[Callable[[str], None]]:
    """A line on standard error, and how to change it; nothing where nobody watches."""
    if not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console

    with Console(stderr=True).status(f"{text} ...") as status:
        yield status.update


def note(texts: Iterable[str]) -> None:
    """Notes, one line each."""
    for text in texts:
        print(text, file=sys.stderr)


def show(table: object) -> None:
    """A table on standard output; piped, it is plain text and as wide as it needs to be."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else 200
    # No markup: square brackets and colons in a label or an answer are its own.
    Console(width=width, highlight=False, markup=False, emoji=False, file=sys.stdout).print(table)
