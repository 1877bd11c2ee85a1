"""Ctrl-C, even where a library swallows it."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

_asked = threading.Event()


@contextlib.contextmanager
def heeded() -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C, and remember it for `leave_if_asked`."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        del number, frame
        _asked.set()
        raise KeyboardInterrupt

    _asked.clear()
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def leave_if_asked() -> None:
    """Raise KeyboardInterrupt if one was swallowed: Python ignores what is raised in a garbage collector's callback."""
    if _asked.is_set():
        raise KeyboardInterrupt
