"""How far a campaign is."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from glucoloop.cli.interrupts import leave_if_asked
from glucoloop.cli.trial_progress import BETWEEN_LINES_S


@contextlib.contextmanager
def loops_counted(loops: int) -> Iterator[Callable[[int], None]]:
    """Tell on standard error how many loops are closed: a bar where somebody watches, else a line now and then."""
    closed = 0
    with _bar(loops) if sys.stderr.isatty() else _lines(loops) as update:

        def more(number: int) -> None:
            nonlocal closed
            leave_if_asked()
            closed += number
            update(closed)

        yield more


@contextlib.contextmanager
def _bar(loops: int) -> Iterator[Callable[[int], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.completed:.0f} of {task.total:.0f} loops"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("loops", total=loops)
        yield lambda closed: progress.update(task, completed=closed)


@contextlib.contextmanager
def _lines(loops: int) -> Iterator[Callable[[int], None]]:
    last = time.monotonic()

    def update(closed: int) -> None:
        nonlocal last
        if time.monotonic() - last < BETWEEN_LINES_S:
            return
        last = time.monotonic()
        print(f"{closed} of {loops} loops", file=sys.stderr)

    yield update
