"""Telling the user's mistake, in one sentence, from a bug, which keeps its traceback."""

from __future__ import annotations

import sys
import traceback
from pathlib import Path
from typing import Final, NoReturn

from glucoloop.trials.printable import printable

_PACKAGE: Final = Path(__file__).resolve().parent.parent
_LONGEST: Final = 2000


def sentence(error: Exception) -> str | None:
    """What to say about an error, or None if it is a bug.

    The library refuses with a sentence of its own. A ValueError that another library raises was not foreseen.
    """
    if isinstance(error, OSError):
        return _of_the_system(error)
    origin = Path(traceback.extract_tb(error.__traceback__)[-1].filename)
    return str(error) if origin.resolve().is_relative_to(_PACKAGE) else None


def mistake(told: str) -> NoReturn:
    """Say a sentence and leave."""
    told = printable(told)
    if len(told) > _LONGEST:  # somebody's value; what is to be done about it stands at the end
        told = f"{told[: _LONGEST // 2]} ... {told[-_LONGEST // 2 :]}"
    end = "" if told.endswith(("?", ".")) else "."
    print(f"glucoloop: {told}{end}", file=sys.stderr)
    sys.exit(2)


def interrupted(told: str = "interrupted, nothing was written") -> NoReturn:
    """Leave after Ctrl-C."""
    print(f"glucoloop: {told}.", file=sys.stderr)
    # An interrupt that lands in an exec, which dataclasses use, marks the process: `python -m` would then end as if
    # nobody had caught it. The next exec takes the mark away.
    exec("")
    sys.exit(130)


def _of_the_system(error: OSError) -> str | None:
    if error.strerror is None:
        return None
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror}; nothing was written, free some space or choose another place"
