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
    """Raise KeyboardInterrupt on Ctrl-C, and remember it for `raise_if_interrupted`.

    While a module is imported the first is only remembered: extensions tell it as an error of their own.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        del number
        first = not _interrupted.is_set()
        _interrupted.set()
        if not (first and _imports(frame)):
            raise KeyboardInterrupt

    def other_exceptions(swallowed: sys.UnraisableHookArgs) -> None:
        if not issubclass(swallowed.exc_type, KeyboardInterrupt):
            hook(swallowed)

    _interrupted.clear()
    hook, sys.unraisablehook = sys.unraisablehook, other_exceptions
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = hook


def _imports(frame: FrameType | None) -> bool:
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def raise_if_interrupted() -> None:
    """Raise KeyboardInterrupt if one was swallowed: Python ignores what is raised in a garbage collector's callback."""
    if _interrupted.is_set():
        raise KeyboardInterrupt


def leave_to_the_system() -> None:
    """Let Ctrl-C end the process at once, for the rest of a command that writes nothing."""
    raise_if_interrupted()
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_DFL)
