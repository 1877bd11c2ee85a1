"""Work that Ctrl-C and a time limit end at once, even if the library that does it checks for neither.

DuckDB checks for an interrupt between chunks of rows, so a function that works for minutes on one value does not notice
it. Therefore the work is done in a thread of its own, which is left behind if it does not stop; `program` in the
command line then ends the process without waiting for it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Final, Generic, TypeVar

T = TypeVar("T")

GRACE_S: Final = 0.5
"""Time to wait for work that was asked to stop."""
_AGAIN_S: Final = 0.02
_LOOK_S: Final = 0.05
LEFT_BEHIND: Final = "glucoloop left this behind"
"""Name of a thread that did not stop."""


class TimeLimitError(Exception):
    """The time limit was reached."""


class Stoppable(Generic[T]):
    """Runs pieces of work, one at a time, until a time limit for all of them.

    Parameters
    ----------
    stop : callable
        Function that asks the work to stop; it may be called when there is none.
    timeout_s : float, optional
        Time for all pieces together; no limit by default.
    """

    def __init__(self, stop: Callable[[], None], timeout_s: float | None = None) -> None:
        self._stop = stop
        self._deadline = None if timeout_s is None else time.monotonic() + timeout_s

    def run(self, work: Callable[[], T]) -> T:
        """Do a piece of work and return what it returns, or raise what it raises.

        Raises
        ------
        TimeLimitError
            If the time limit is reached first.
        KeyboardInterrupt
            As soon as Ctrl-C is pressed.
        """
        self._check_time()
        answers: list[T] = []
        errors: list[BaseException] = []
        # Not `join`: interrupted, it takes the thread for ended.
        ended = threading.Event()

        def tell() -> None:
            try:
                answers.append(work())
            except BaseException as error:
                errors.append(error)
            finally:
                ended.set()

        thread = threading.Thread(target=tell, daemon=True)
        try:
            thread.start()
            # Where a signal reaches another thread, a wait without end would not be woken.
            while not ended.wait(_LOOK_S):
                self._check_time()
        except BaseException:
            self._end(thread, ended)
            raise
        if errors:
            raise errors[0]
        return answers[0]

    def _check_time(self) -> None:
        if self._deadline is not None and time.monotonic() >= self._deadline:
            raise TimeLimitError

    def _end(self, thread: threading.Thread, ended: threading.Event) -> None:
        """Ask the work to stop, repeatedly, since it may not have begun at the first request."""
        until = time.monotonic() + GRACE_S
        while not ended.is_set() and time.monotonic() < until:
            self._stop()
            ended.wait(_AGAIN_S)
        if not ended.is_set():
            thread.name = LEFT_BEHIND


def left_behind() -> bool:
    """Whether there is work that did not stop and for which the end of the process would wait."""
    return any(thread.name == LEFT_BEHIND for thread in threading.enumerate())
