"""Bound on the memory of this process while a library computes whose own bound does not count all that it takes."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

if sys.platform == "linux":
    import resource


@contextlib.contextmanager
def memory_limited(most_bytes: int) -> Iterator[None]:
    """Let this process, all its threads together, take at most so many bytes more in the block than it has.

    Beyond them the system hands out no memory, which Python tells as MemoryError. Linux alone counts the private memory
    of a process against such a limit; other systems have no bound here.
    """
    if sys.platform != "linux":
        yield
        return
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = pages * resource.getpagesize() + most_bytes
    resource.setrlimit(resource.RLIMIT_DATA, (most if soft == resource.RLIM_INFINITY else min(soft, most), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
