"""Arrays that are zero almost everywhere, against NumPy's own."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.sparse import Sparse, dense

ENTRIES = st.lists(st.tuples(st.integers(0, 5), st.integers(0, 3), st.floats(-9.0, 9.0)), max_size=12)


@given(ENTRIES)
def test_numbers_that_share_a_place_are_added_up(entries):
    row, person = (np.array([entry[i] for entry in entries], np.intp) for i in (0, 1))
    number = np.array([entry[2] for entry in entries], float)
    expected = np.zeros((2, 3, 4))
    for r, p, n in entries:
        expected[r // 3, r % 3, p] += n
    sparse = Sparse((2, 3, 4), row, person, number)
    np.testing.assert_array_equal(dense(sparse), expected)
    np.testing.assert_array_equal(sparse.reshaped(3, 2).dense(), expected.reshape(3, 2, 4))
    assert dense(expected) is expected
