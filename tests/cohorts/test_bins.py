"""Counts in bins, against NumPy's histogram."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glucoloop.cohorts.bins import count, glucose_edges, insulin_edges


def by_numpy(values, edges):
    inside = np.clip(values.astype(float), edges[0], np.nextafter(edges[-1], 0.0))
    return np.stack([np.histogram(row, edges)[0] for row in inside])


def test_edges_of_glucose():
    edges = glucose_edges()
    assert edges[0] == 0.0
    assert edges[-1] == 600.0
    np.testing.assert_array_equal(np.diff(edges), 1.0)


@pytest.mark.parametrize(("most", "end"), [(66.9, 67.25), (60.0, 60.25), (0.1, 0.5)])
def test_edges_of_insulin_reach_beyond_the_limit(most, end):
    edges = insulin_edges(most)
    assert edges[-1] == end
    np.testing.assert_array_equal(np.diff(edges), 0.25)


@pytest.mark.long
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("edges", [glucose_edges(), insulin_edges(66.9)], ids=["glucose", "insulin"])
@given(st.data())
def test_counts_are_those_of_numpy(edges, dtype, data):
    limit = float(2.0 * edges[-1])
    numbers = st.one_of(
        st.floats(-10.0, limit, width=32),
        st.sampled_from([float(e) for e in edges[:9]] + [float(edges[-1]), 0.0, -0.0]),
    )
    values = data.draw(hnp.arrays(dtype, hnp.array_shapes(min_dims=2, max_dims=2, max_side=6), elements=numbers))
    found = count(values, edges)
    assert found.dtype == np.int64
    np.testing.assert_array_equal(found, by_numpy(values, edges))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_lies_far_beyond_falls_in_the_outermost_bins(dtype):
    found = count(np.array([[-1e30, 1e30, 600.0, 599.9]], dtype), glucose_edges())
    assert found[0, 0] == 1
    assert found[0, -1] == 3
    assert found.sum() == 4


def test_a_value_on_an_edge_counts_above_it():
    found = count(np.array([[81.0, np.nextafter(81.0, 0.0), 0.0]]), glucose_edges())
    assert found[0, [0, 80, 81]].tolist() == [1, 1, 1]


def test_what_is_counted_is_left_as_it_is_and_nobody_is_nothing():
    values = np.array([[3.7, 700.0]])
    count(values, glucose_edges())
    np.testing.assert_array_equal(values, [[3.7, 700.0]])
    np.testing.assert_array_equal(count(np.zeros((4, 0)), glucose_edges()), np.zeros((4, 600)))
