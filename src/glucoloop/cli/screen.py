"""Output of a command: results on standard output, and the rest on standard error, or in one file.

Whatever a command prints passes through here, where control characters become their escapes: a text of a file could
otherwise command the terminal.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from glucoloop.cli.interrupts import raise_if_interrupted
from glucoloop.refusal import Refusal
from glucoloop.text import printable, printable_json, printable_lines, without_credentials

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.segment import Segment


_PIPED: Final = 200
_WIDEST_TEXT: Final = 100


def width_of_text() -> int:
    """Width of a help text."""
    return min(_WIDEST_TEXT, shutil.get_terminal_size((_WIDEST_TEXT, 24)).columns)


@contextlib.contextmanager
def stage(text: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner with a text during the block, on a terminal only.

    The block is given a function that shows the step that was just done in place of the text.
    """
    with contextlib.ExitStack() as stack:
        update: Callable[[str], None] | None = None
        if sys.stderr.isatty():
            from rich.console import Console

            update = stack.enter_context(Console(stderr=True, markup=False).status(f"{printable(text)} ...")).update

        def done(what: str) -> None:
            raise_if_interrupted()
            if update is not None:
                update(f"Done: {printable(what)} ...")

        yield done
    raise_if_interrupted()


def print_text(text: str, *, end: str = "\n", error: bool = False) -> None:
    """Print a text of one line or several on standard output, or on standard error, there without credentials."""
    text = without_credentials(text) if error else text
    print(printable_lines(text), end=end, file=sys.stderr if error else sys.stdout)


_NOTES: Final[ContextVar[list[str] | None]] = ContextVar("notes", default=None)


@contextlib.contextmanager
def collected_notes() -> Iterator[list[str]]:
    """List that collects the notes of the block, which are not printed then."""
    notes: list[str] = []
    token = _NOTES.set(notes)
    try:
        yield notes
    finally:
        _NOTES.reset(token)


def for_terminal() -> bool:
    """Whether a command runs for a terminal; otherwise a function of Python carries it out."""
    return _NOTES.get() is None


def note(texts: Iterable[str]) -> None:
    """Print notes, one line each."""
    notes = _NOTES.get()
    for text in texts:
        if notes is None:
            print_text(printable(text), error=True)
        else:
            notes.append(text)


class _Printable:
    """Renderable of rich, with escapes in the place of control characters of its texts."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        from rich.segment import Segment

        for segment in console.render(self.inner, options):
            yield segment if segment.control else Segment(printable_lines(segment.text), segment.style)


def show(table: object) -> None:
    """Print a table on standard output; piped, it is plain text of up to 200 characters a line."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else _PIPED
    # No markup: square brackets and colons in a label or an answer are its own.
    Console(width=width, highlight=False, markup=False, emoji=False, file=sys.stdout).print(_Printable(table))


def print_value(value: object, other: Callable[[Any], object] | None = None) -> None:
    """Print a value as JSON; `other` makes plain what is not."""
    from glucoloop.storage.files import json_text

    print(printable_json(json_text(value, other)))


class _StandardOutput:
    """Standard output as a file to write to."""

    def write(self, text: str) -> None:
        print_text(text, end="")


def print_rows(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a CSV table with the names of its columns."""
    from glucoloop.spreadsheet import write_rows

    write_rows(_StandardOutput(), names, rows)


def print_json(report: Mapping[str, Any], files: Mapping[str, str], notes: Iterable[str] = ()) -> None:
    """Print the report with the paths of its files, and notes on standard error."""
    from glucoloop.storage.files import with_version

    print_value({**with_version(report), "files": files})
    note(notes)


def where_written(out: Path | None, files: Mapping[str, str]) -> str:
    """Sentence on the place of the files, or on how to get them."""
    if out is None:
        return "Nothing was written; --out DIR keeps tables, figures and the configuration."
    return f"Wrote {', '.join(files)} to {out}."


def file_to_write(given: Mapping[str, Any]) -> Path | None:
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
