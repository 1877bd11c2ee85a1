"""Output of a command: results on standard output, and everything else on standard error."""

from __future__ import annotations

import contextlib
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from glucoloop.cli.interrupts import raise_if_interrupted

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

            update = stack.enter_context(Console(stderr=True).status(f"{text} ...")).update

        def done(what: str) -> None:
            raise_if_interrupted()
            if update is not None:
                update(f"Done: {what} ...")

        yield done
    raise_if_interrupted()


def note(texts: Iterable[str]) -> None:
    """Print notes, one line each."""
    for text in texts:
        print(text, file=sys.stderr)


def show(table: object) -> None:
    """Print a table on standard output; piped, it is plain text of up to 200 characters a line."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else _PIPED
    # No markup: square brackets and colons in a label or an answer are its own.
    Console(width=width, highlight=False, markup=False, emoji=False, file=sys.stdout).print(table)


def print_json(report: Mapping[str, Any], files: Mapping[str, str], notes: Iterable[str] = ()) -> None:
    """Print the report with the paths of its files, and notes on standard error."""
    from glucoloop.storage.files import json_text, with_version

    print(json_text({**with_version(report), "files": files}))
    note(notes)


def where_written(out: Path | None, files: Mapping[str, str]) -> str:
    """Sentence on the place of the files, or on how to get them."""
    if out is None:
        return "Nothing was written; --out DIR keeps tables, figures and the configuration."
    return f"Wrote {', '.join(files)} to {out}."
