"""Work that Ctrl-C and a time limit end at once, even if the library that does it checks for neither.

DuckDB checks for an interrupt between chunks of rows, so a function that works for minutes on one value notices neither
a timer nor Ctrl-C. Therefore the work is done in a thread of its own, which is left behind if it does not stop;
`program` in the command line then ends the process without waiting for it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Final, Generic, TypeVar

T = TypeVar("T")

GRACE_S: Final = 0.5
"""Time to wait for work that was asked to stop."""
_AGAIN_S: Final = 0.02
_LOOK_S: Final = 0.05
UNSTOPPED: Final = "glucoloop left this behind"
"""Name of a thread that did not stop."""


class TimeLimitError(Exception):
    """The time limit was reached."""


class Stoppable(Generic[T]):
    """Runs pieces of work, one at a time, until a time limit for all of them, if there is one.

    `stop` asks the work to stop; it may be called when there is none.
    """

    def __init__(self, stop: Callable[[], None], timeout_s: float | None = None) -> None:
        self._stop = stop
        self._deadline = None if timeout_s is None else time.monotonic() + timeout_s

    def run(self, work: Callable[[], T]) -> T:
        """Return what a piece of work returns, or raise what it raises, `TimeLimitError`, or KeyboardInterrupt."""
        answer: Future[T] = Future()

        def carry_out() -> None:
            try:
                answer.set_result(work())
            except BaseException as error:
                answer.set_exception(error)

        thread = threading.Thread(target=carry_out, daemon=True)
        try:
            self._check_time()
            thread.start()
            # Where a signal reaches another thread, a wait without end would not be woken.
            while not wait([answer], _LOOK_S).done:
                self._check_time()
        except BaseException:
            # Repeatedly, since the work may not have begun at the first request.
            until = time.monotonic() + GRACE_S
            while thread.is_alive() and not answer.done() and time.monotonic() < until:
                self._stop()
                wait([answer], _AGAIN_S)
            if thread.is_alive() and not answer.done():
                thread.name = UNSTOPPED
            raise
        return answer.result()

    def _check_time(self) -> None:
        if self._deadline is not None and time.monotonic() >= self._deadline:
            raise TimeLimitError


def has_unstopped_work() -> bool:
    """Whether there is work that did not stop and for which the end of the process would wait."""
    return any(thread.name == UNSTOPPED for thread in threading.enumerate())
