"""Handling of Ctrl-C, also where a library swallows the exception."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

_interrupted = threading.Event()


@contextlib.contextmanager
def catching_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C, and remember it for `raise_if_interrupted`."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        del number, frame
        _interrupted.set()
        raise KeyboardInterrupt

    def tell(swallowed: sys.UnraisableHookArgs) -> None:
        if not issubclass(swallowed.exc_type, KeyboardInterrupt):
            hook(swallowed)

    _interrupted.clear()
    hook, sys.unraisablehook = sys.unraisablehook, tell
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = hook


def raise_if_interrupted() -> None:
    """Raise KeyboardInterrupt if one was swallowed: Python ignores what is raised in a garbage collector's callback."""
    if _interrupted.is_set():
        raise KeyboardInterrupt
