"""Progress of long work: how much is done, at what rate, and how much longer it takes."""

from __future__ import annotations

import contextlib
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Final

from glucoloop.cli.interrupts import raise_if_interrupted

BETWEEN_LINES_S: Final = 10.0
_REMEMBERED_S: Final = 30.0
_Shown = Callable[[float, str, float], None]
"""Function that shows the amount that is done, the same in words, and the rate per second."""


@contextlib.contextmanager
def counted(total: int, before: int, what: str) -> Iterator[Callable[[float], None]]:
    """Show on standard error how much is done while the block works: a bar on a terminal, else a line now and then.

    Of `total` units of work, ``"people"``, some were done before; the block calls the function that it is given with
    the number that was done since the last call.
    """
    # The last half minute sets the rate: the time of a start, most of it compiling, is soon forgotten.
    remembered = deque([(time.monotonic(), float(before))])
    with _bar(total, before, what) if sys.stderr.isatty() else contextlib.nullcontext(_lines(total)) as show:

        def more(number: float) -> None:
            raise_if_interrupted()
            now, done = time.monotonic(), remembered[-1][1] + number
            remembered.append((now, done))
            while len(remembered) > 2 and remembered[0][0] < now - _REMEMBERED_S:
                remembered.popleft()
            since, then = remembered[0]
            rate = (done - then) / max(now - since, 1e-9)
            rate_text = f"{rate:.3g}" if rate < 1000.0 else f"{rate:.0f}"
            show(done, f"{int(done)} of {total} {what}, {rate_text} {what}/s", rate)

        yield more
    raise_if_interrupted()


@contextlib.contextmanager
def _bar(total: int, before: int, what: str) -> Iterator[_Shown]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.fields[text]}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        TimeRemainingColumn(compact=True),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(what, total=total - before, text=f"{before} of {total} {what}")
        yield lambda done, text, rate: progress.update(task, completed=done - before, text=text)


def _lines(total: int) -> _Shown:
    last = time.monotonic()

    def show(done: float, text: str, rate: float) -> None:
        nonlocal last
        if time.monotonic() - last >= BETWEEN_LINES_S:
            last = time.monotonic()
            left = f"{_duration((total - done) / rate)} left" if rate else "waiting"
            print(f"{text}, {left}", file=sys.stderr)

    return show


def _duration(seconds: float) -> str:
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
