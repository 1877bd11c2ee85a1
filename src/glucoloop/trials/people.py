"""People of a trial: blocks of one size in which they are simulated, and their results, one row a person.

The last block is filled up by repetition. So each person is computed by the same code, with results that are the same
to the bit whoever else is simulated, in whatever order, and by any number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from glucoloop.trials.trial import MIN_BLOCK

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PeopleRows:
    """Some people of a trial under one controller, in the order of their numbers."""

    person: npt.NDArray[np.int64]
    """(n,) numbers of the people."""
    feasible: npt.NDArray[np.bool_]
    """(n,) whether a basal rate holds the person at the setpoint; without one the run cannot start."""
    basal_insulin_mU_min: Floats
    """(n,) basal rates, NaN for people without one."""
    drawn: Mapping[str, Floats]
    """(n,) drawn values of each parameter."""
    metrics: Mapping[str, npt.NDArray[Any]]
    """(n,) values of each metric by its name in `metrics.metric`; NaN for people without a basal rate."""
    yes_or_no: frozenset[str] = frozenset()
    """Metrics that are 0 or 1."""
    profile: Mapping[str, Floats] = field(default_factory=dict)
    """(n,) known fields of the people's profiles, those of `trials.trial.profile_columns`."""

    @property
    def below_validity(self) -> npt.NDArray[np.bool_]:
        """(n,) whether glucose was ever below the range in which the person's model is valid.

        It is False throughout where that was not measured, in folders of an earlier version.
        """
        result = self.metrics.get("time_below_validity_pct", np.zeros(self.person.shape))
        ever: npt.NDArray[np.bool_] = result > 0.0
        return ever


Shard = Mapping[str, PeopleRows]
"""Results of a shard by the label of the controller."""
Shards = Callable[[], Iterable[Shard]]
"""Function that reads the shards again from the first one, so that only one at a time is in memory."""


T = TypeVar("T")

_SIZES: Final = {"native": 1024, "xla": 64}
"""Number of people in a block: enough that a block's own cost is small, few enough that filling up the last one is.

Of trials that are long or slow it is less, see `trials.trial.Trial.people_a_block`.
"""


def block_size(engine: str) -> int:
    """Number of people who are simulated together."""
    return _SIZES[engine]


def few_in_a_block(people: int) -> int:
    """Number of people in a block that so few fill, so that hardly more are simulated than who is asked for.

    JAX still has as many people of `block_size` before it, for another number might have other last digits.
    """
    return max(MIN_BLOCK, 1 << (people - 1).bit_length())


def in_blocks(
    run: Callable[[npt.NDArray[Any], int], T],
    values: npt.NDArray[Any],
    size: int,
    threads: int | None = None,
    *,
    done: Callable[[int], None] = lambda number: None,
) -> list[T]:
    """Results of a function on full blocks of values ``(n,)``, in their order.

    The function gets a full block, and the number of its first members that were asked for; `done` is called with that
    number in this thread after each block, in their order. By default there are two threads for each core, so that it
    works while one of them waits for another to leave Python or JAX.
    """
    results: list[T] = []

    def take(computed: Iterable[T]) -> list[T]:
        for part, number in zip(computed, sizes, strict=True):
            results.append(part)
            done(number)
        return results

    parts = [values[start : start + size] for start in range(0, values.size, size)]
    blocks, sizes = [np.resize(part, size) for part in parts], [part.size for part in parts]
    threads = min(threads or 2 * (os.cpu_count() or 1), len(blocks))
    if threads <= 1:
        return take(map(run, blocks, sizes))
    with ThreadPoolExecutor(threads) as pool:
        try:
            return take(pool.map(run, blocks, sizes))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
