"""Inputs of people in memory that a thread keeps from one run to the next."""

from types import SimpleNamespace

import numpy as np
import pytest

from glucoloop.simulation.engines import _arriving
from glucoloop.sparse import Sparse

KERNEL = SimpleNamespace(
    lanes=4, sizes={"own": 3}, dtype=np.dtype("float32"), padded=lambda people: -(-people // 4) * 4
)
SAMPLES, PEOPLE = 5, 6


def leaves(rng):
    """Two numbers that are zero almost everywhere, one place with two of them, and one that is not."""
    row, person = np.array([0, 3, 3, 9]), np.array([5, 0, 0, 4])
    return Sparse((SAMPLES, 2, PEOPLE), row, person, rng.normal(size=4)), rng.normal(size=(SAMPLES, PEOPLE))


def by_numpy(sparse, dense):
    """The same, ``(vectors, samples, numbers, lanes)``."""
    whole = np.zeros((SAMPLES, 3, 8), np.float32)
    np.add.at(whole, (sparse.row // 2, sparse.row % 2, sparse.person), sparse.number.astype(np.float32))
    whole[:, 2, :PEOPLE] = dense
    return whole.reshape(SAMPLES, 3, 2, 4).transpose(2, 0, 1, 3)


def test_what_was_written_for_others_is_cleared():
    rng = np.random.default_rng(0)
    for _ in range(3):
        given = leaves(rng)
        with _arriving(KERNEL, SAMPLES, given, PEOPLE) as own:
            np.testing.assert_array_equal(own, by_numpy(*given))
    with _arriving(KERNEL, 2 * SAMPLES, [], PEOPLE) as own:
        assert not own.any()


def test_what_an_interrupted_run_left_is_forgotten():
    with pytest.raises(KeyboardInterrupt), _arriving(KERNEL, SAMPLES, leaves(np.random.default_rng(1)), PEOPLE):
        raise KeyboardInterrupt
    with _arriving(KERNEL, SAMPLES, [], PEOPLE) as own:
        assert not own.any()
