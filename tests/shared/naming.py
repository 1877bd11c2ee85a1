"""Many cases in one test: a failure tells which of them it is about."""

import contextlib
from collections.abc import Iterator


@contextlib.contextmanager
def naming(*case: object) -> Iterator[None]:
    """Add the name of a case to whatever is raised in the block."""
    try:
        yield
    except BaseException as error:
        error.add_note(f"in the case: {' '.join(map(str, case))}")
        raise
