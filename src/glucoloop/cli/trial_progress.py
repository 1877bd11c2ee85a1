"""Progress of a trial, its rate, and the remaining time."""

from __future__ import annotations

import contextlib
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Final

from glucoloop.cli.interrupts import leave_if_asked

BETWEEN_LINES_S: Final = 10.0
_REMEMBERED_S: Final = 30.0


@contextlib.contextmanager
def counted(people: int, before: int, controllers: int) -> Iterator[Callable[[int], None]]:
    """Report on standard error the number of people done during the block.

    It is a bar on a terminal, and otherwise a line every ten seconds. It counts people under one controller each; a
    person is done when all controllers are.
    """
    told = _bar(people, before) if sys.stderr.isatty() else _lines(people, before)
    with told as update:
        tried = 0

        def done(number: int) -> None:
            nonlocal tried
            leave_if_asked()
            tried += number
            update(tried / controllers)

        yield done
    leave_if_asked()


class _Rate:
    """Recent rate in people per second; the slow start soon loses its weight."""

    def __init__(self) -> None:
        self._done = deque([(time.monotonic(), 0.0)])

    def people_s(self, done: float) -> float:
        """The rate after a number of people done."""
        now = time.monotonic()
        self._done.append((now, done))
        while len(self._done) > 2 and self._done[0][0] < now - _REMEMBERED_S:
            self._done.popleft()
        since, before = self._done[0]
        return (done - before) / max(now - since, 1e-9)


@contextlib.contextmanager
def _bar(people: int, before: int) -> Iterator[Callable[[float], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.fields[told]}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        TimeRemainingColumn(compact=True),
    )
    rate = _Rate()
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("people", total=people - before, told=f"{before} of {people} people")

        def update(done: float) -> None:
            told = f"{before + int(done)} of {people} people, {_told(rate.people_s(done))}"
            progress.update(task, completed=done, told=told)

        yield update


@contextlib.contextmanager
def _lines(people: int, before: int) -> Iterator[Callable[[float], None]]:
    rate, last = _Rate(), time.monotonic()

    def update(done: float) -> None:
        nonlocal last
        people_s = rate.people_s(done)
        if time.monotonic() - last < BETWEEN_LINES_S:
            return
        last = time.monotonic()
        left = f"{_duration((people - before - done) / people_s)} left" if people_s else "waiting"
        print(f"{before + int(done)} of {people} people, {_told(people_s)}, {left}", file=sys.stderr)

    yield update


def _told(people_s: float) -> str:
    return f"{people_s:.3g} people/s" if people_s < 1000.0 else f"{people_s:.0f} people/s"


def _duration(seconds: float) -> str:
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
