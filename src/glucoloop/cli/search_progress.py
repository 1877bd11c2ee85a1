"""Progress of a search, its rate, and the remaining time."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from glucoloop.cli.interrupts import leave_if_asked
from glucoloop.cli.screen import stages
from glucoloop.cli.trial_progress import BETWEEN_LINES_S


@contextlib.contextmanager
def counted_out(before: int, wanted: int, what: str) -> Iterator[Callable[[int], None]]:
    """Report progress on standard error: in one line on a terminal, otherwise from time to time."""
    since, last = time.monotonic(), time.monotonic()
    started: int | None = None

    def told(done: int) -> str:
        # the first one waits for the compiler, and is no measure of the others
        further = done - (before if started is None else started)
        rate = further / max(time.monotonic() - since, 1e-9)
        left = f", {_duration((wanted - done) / rate)} left" if further and started is not None else ""
        return f"{done} of {wanted} {what}{left}"

    with stages(f"Trying {wanted - before} {what}") as update:

        def tell(done: int) -> None:
            nonlocal since, last, started
            leave_if_asked()
            if started is None:
                since, started = time.monotonic(), done
            update(told(done))
            if not sys.stderr.isatty() and time.monotonic() - last > BETWEEN_LINES_S:
                last = time.monotonic()
                print(told(done), file=sys.stderr)

        yield tell


def _duration(seconds: float) -> str:
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    return f"{whole // 60} min {whole % 60} s" if whole < 3600 else f"{whole // 3600} h {whole % 3600 // 60} min"
