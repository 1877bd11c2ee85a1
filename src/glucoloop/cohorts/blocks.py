"""People in blocks of one size, however many are asked for: the last one is filled up by repetition.

So each person goes through the same code, and is the same to the bit whoever else is asked for, in whatever order, and
by how many threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

T = TypeVar("T")

_SIZES: Final = {"native": 2048, "xla": 64}
"""As many as fit the caches, and few where each takes long."""


def block_size(engine: str) -> int:
    """People that go through a loop together."""
    return _SIZES[engine]


def in_blocks(
    run: Callable[[npt.NDArray[Any], int], T], values: npt.NDArray[Any], size: int, threads: int | None = None
) -> list[T]:
    """Results of a function on full blocks of values, in their order.

    Parameters
    ----------
    run : callable
        Of a full block, and how many of it, from the first on, were asked for.
    values : (n,) array
    size : int
        Of a block.
    threads : int, optional
        One for each core by default.
    """
    parts = [values[start : start + size] for start in range(0, values.size, size)]
    blocks, asked = [np.resize(part, size) for part in parts], [part.size for part in parts]
    threads = min(threads or os.cpu_count() or 1, len(blocks))
    if threads <= 1:
        return [run(block, n) for block, n in zip(blocks, asked, strict=True)]
    with ThreadPoolExecutor(threads) as pool:
        try:
            return list(pool.map(run, blocks, asked))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
