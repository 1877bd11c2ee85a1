"""Errors of the user and of the machine in one sentence; a bug keeps its traceback.

All errors of all commands pass through here, so that each kind is worded in one place.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import traceback
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Final, NoReturn, TypeVar

from glucoloop.cli.screen import print_text
from glucoloop.refusal import Refusal
from glucoloop.text import one_line, printable

T = TypeVar("T")
_LONGEST: Final = 2000
_LIBRARIES_WITH_MEMORY: Final = ("_duckdb", "duckdb", "llvmlite", "polars", "pyarrow")
"""Libraries that say that memory ran out by errors of their own, which are no RuntimeErrors."""
_COMPUTING: Final = ("diffrax", "jax", "jaxlib", "llvmlite", "scipy")
"""Libraries of a simulation, which the package glucoloop-records leaves out."""
_OUT_OF_MEMORY: Final = ("resource_exhausted", "out of memory", "bad_alloc", "bad allocation", "cannot allocate memory")
"""Words of libraries, in small letters, where memory ran out; XLA gives the first two."""
KEPT_RESULTS: Final[ContextVar[str | None]] = ContextVar("results", default=None)
"""State of the results of the command as part of a sentence; None for one that says it itself."""
COMMAND: Final[ContextVar[tuple[str, frozenset[str]] | None]] = ContextVar("command", default=None)
"""Name of the command, and its options, of which alone a refusal may speak."""
BUG: Final = (
    "This is a bug, of glucoloop or of the code of your own that the last lines name. Report it with these lines and "
    "the command."
)
"""Sentence below the traceback of an error that is nobody's refusal."""


def sentence(error: BaseException) -> str | None:
    """Sentence for an error, or None if it is a bug.

    What is refused is a `Refusal`, whose words are the sentence. Any other ValueError is a bug.
    """
    if _is_out_of_memory(error):
        return _with_results("there is not enough memory for this; ask for fewer people, days, samples or rows")
    if _is_of_jax(error, "Unable to initialize backend") or _is_of_jax(error, "Unknown backend"):
        platforms = os.environ.get("JAX_PLATFORMS")
        config = "" if platforms is None else f" as JAX_PLATFORMS={platforms} asks"
        return f"JAX cannot start{config}: {one_line(error)}; unset JAX_PLATFORMS, or set it to cpu"
    kind = type(error)  # concurrent.futures takes long to import
    package, cancelled = kind.__module__.partition(".")[0], ("concurrent", "CancelledError")
    if package in ("dask", "distributed") or (package, kind.__name__) == cancelled:
        why = one_line(error) or type(error).__name__
        return (
            f"the connection to the Dask scheduler was lost ({why}); the shards that are done are kept, start the "
            "scheduler again and run the same command again"
        )
    if isinstance(error, RuntimeError) and _was_raised_in(error, "pathlib.py"):  # Python before 3.13
        return _with_results(f"{one_line(error)}; choose another place")
    if isinstance(error, OSError):
        return _of_the_system(error)
    if isinstance(error, ModuleNotFoundError) and error.name in _COMPUTING:
        return f"this computes with {error.name}, which is not installed; install it with: pip install glucoloop"
    if not isinstance(error, Refusal):
        return None
    command = COMMAND.get()
    return str(error) if command is None else error.of_command(*command)


@contextlib.contextmanager
def written_whole(folder: contextlib.AbstractContextManager[T], out: Path | None) -> Iterator[T]:
    """An output folder that is written at the end of the block or not at all."""
    KEPT_RESULTS.set("nothing was written")
    with folder as entered:
        yield entered
    if out is not None:
        KEPT_RESULTS.set(f"the results are in {out}")


def mistake(message: str) -> NoReturn:
    """Print a sentence and exit with code 2."""
    message = printable(message)
    if len(message) > _LONGEST:  # somebody's value; what is to be done about it stands at the end
        message = f"{message[: _LONGEST // 2]} ... {message[-_LONGEST // 2 :]}"
    end = "" if message.endswith(("?", ".")) else "."
    print_text(f"glucoloop: {message}{end}", error=True)
    sys.exit(2)


def interrupted(message: str | None = None) -> NoReturn:
    """Exit after Ctrl-C."""
    print_text(f"glucoloop: {message or _with_results('interrupted')}.", error=True)
    # An interrupt that lands in an exec, which dataclasses use, marks the process: `python -m` would then end as if
    # nobody had caught it. The next exec takes the mark away.
    exec("")
    sys.exit(130)


def _of_the_system(error: OSError) -> str | None:
    from glucoloop.storage.disk import mend

    if error.strerror is None:
        return None
    where = f"{error.filename}: " if error.filename else ""
    ways = mend(error, "choose another place") if mend(error) or error.filename else ""
    return _with_results(f"{where}{error.strerror}") + (f"; {ways}" if ways else "")


def _with_results(message: str) -> str:
    """Sentence with the state of the results appended, if it is known."""
    known = KEPT_RESULTS.get()
    return message if known is None else f"{message}, {known}"


def _is_out_of_memory(error: BaseException) -> bool:
    """Whether memory ran out: each library says so in its own class, and some in words only."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return True
    of_library = isinstance(error, RuntimeError) or type(error).__module__.partition(".")[0] in _LIBRARIES_WITH_MEMORY
    words = str(error).lower()
    return of_library and any(word in words for word in _OUT_OF_MEMORY)


def _is_of_jax(error: BaseException, text: str) -> bool:
    """Whether an error is from JAX or XLA, whose errors have no classes of their own."""
    return isinstance(error, RuntimeError) and text in str(error)


def _was_raised_in(error: BaseException, file: str) -> bool:
    return Path(traceback.extract_tb(error.__traceback__)[-1].filename).resolve().name == file
