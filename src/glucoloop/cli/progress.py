"""Progress of long work: how much is done, at what rate, and how much longer it takes."""

from __future__ import annotations

import contextlib
import datetime
import sys
import time
from collections.abc import Callable, Iterator
from typing import Final

from glucoloop.cli.interrupts import raise_if_interrupted
from glucoloop.cli.screen import print_text
from glucoloop.text import how_many

BETWEEN_LINES_S: Final = 10.0
_MEASURED_S: Final = 5.0
"""Time over which the first work is timed, from its first report on: what comes before is mostly compiling."""
_LONG_S: Final = 60.0
"""Time above which it is said how long the rest takes."""


@contextlib.contextmanager
def counted(total: int, before: int, what: str, *, rate_over_s: float = 30.0) -> Iterator[Callable[[float], None]]:
    """Show on standard error how much is done while the block works: a bar on a terminal, else a line now and then.

    Of `total` units of work, ``"people"``, some were done before; the block calls the function that it is given with
    the number that was done since the last call. The last half minute, `rate_over_s`, sets the rate: the time of a
    start, most of it compiling, is soon forgotten. Of long work it is said once, as measured in its first seconds, how
    long the rest takes.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.fields[text]}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        TimeRemainingColumn(compact=True),
    )
    terminal, last_s = sys.stderr.isatty(), time.monotonic()
    console = Console(stderr=True)
    timed_from: tuple[float, float] | None = None
    estimated = False
    with Progress(
        *columns, console=console, transient=True, disable=not terminal, speed_estimate_period=rate_over_s
    ) as progress:
        number = progress.add_task(what, total=total, completed=before, text=f"{before} of {total} {what}")
        [task] = progress.tasks

        def more(done: float) -> None:
            nonlocal last_s, timed_from, estimated
            raise_if_interrupted()
            progress.advance(number, done)
            timed_from = timed_from or (time.monotonic(), task.completed)
            seconds, work = time.monotonic() - timed_from[0], task.completed - timed_from[1]
            if not estimated and seconds >= _MEASURED_S and work > 0.0:
                estimated = True
                left_s = (total - task.completed) * seconds / work
                if left_s >= _LONG_S:
                    sentence = f"The rest takes about {_long(left_s)}, as measured: {_few(work)} of {total} {what} took"
                    console.print(f"{sentence} {seconds:.0f} s.", soft_wrap=True, markup=False, highlight=False)
            rate = task.speed or (task.completed - before) / max(task.elapsed or 0.0, 1e-9)
            text = f"{int(task.completed)} of {total} {what}, {_pace(rate, what)}"
            progress.update(number, text=text)
            if not terminal and time.monotonic() - last_s >= BETWEEN_LINES_S:
                last_s = time.monotonic()
                left = datetime.timedelta(seconds=round((total - task.completed) / rate)) if rate else "an unknown time"
                print_text(f"{text}, {left} left", error=True)

        yield more
    raise_if_interrupted()


def _pace(rate: float, what: str) -> str:
    """Number in a second, or the time of one where that is longer."""
    if 0.0 < rate < 1.0:
        return f"one in {1.0 / rate:.3g} s"
    return f"{rate:.3g} {what}/s" if rate < 1000.0 else f"{rate:.0f} {what}/s"


def _few(work: float) -> str:
    """A number of people or steps, with a digit or two of the part of one that long work is timed by."""
    return f"{work:.0f}" if work >= 100.0 else f"{work:.3g}"


def _long(seconds: float) -> str:
    """A time in the unit that suits its length."""
    minutes = seconds / 60.0
    for amount, unit in ((minutes / 1440.0, "day"), (minutes / 60.0, "hour")):
        if amount >= 2.0:
            return f"{amount:.2g} {unit}s"
    return how_many(round(minutes), "minute")
