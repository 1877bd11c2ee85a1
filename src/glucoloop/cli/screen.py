"""Progress messages on standard error, so that standard output holds only results."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Final

from glucoloop.cli.interrupts import raise_if_interrupted

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_PIPED: Final = 200
_WIDEST: Final = 100_000


@contextlib.contextmanager
def stage(text: str) -> Iterator[None]:
    """Show a spinner with a text during the block, on a terminal only."""
    with _line(text):
        yield
    raise_if_interrupted()


@contextlib.contextmanager
def stages(first: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner during the block, with the last step that the block reported."""
    with _line(first) as update:

        def done(what: str) -> None:
            raise_if_interrupted()
            update(f"Done: {what} ...")

        yield done


@contextlib.contextmanager
def _line(text: str) -> Iterator[Callable[[str], None]]:
    """Show a line on standard error, with a function to change it; nothing if it is not a terminal."""
    if not sys.stderr.isatty():
        yield lambda text: None
        return
    from rich.console import Console

    with Console(stderr=True).status(f"{text} ...") as status:
        yield status.update


def note(texts: Iterable[str]) -> None:
    """Print notes, one line each."""
    for text in texts:
        print(text, file=sys.stderr)


def show(table: object) -> None:
    """Print a table on standard output; piped, it is plain text of up to 200 characters a line."""
    _console().print(table)


def fits(table: Table) -> bool:
    """Whether a table is shown without anything cut off or broken into lines."""
    from rich.measure import Measurement

    console = _console()
    return Measurement.get(console, console.options.update(max_width=_WIDEST), table).maximum <= console.width


def _console() -> Console:
    from rich.console import Console

    width = None if sys.stdout.isatty() else _PIPED
    # No markup: square brackets and colons in a label or an answer are its own.
    return Console(width=width, highlight=False, markup=False, emoji=False, file=sys.stdout)
