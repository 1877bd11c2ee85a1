"""Counts in bins, against NumPy's histogram; quantiles of counts lie in the bin of the true ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glucoloop.trials.bins import BAND_QUANTILES, bin_numbers, glucose_edges, insulin_edges, quantiles_of_counts


def count(values, edges):
    counts = np.zeros((len(values), edges.size - 1), np.int64)
    np.add.at(counts, (np.arange(len(values))[:, None], bin_numbers(values, edges)), 1)
    return counts


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


def counted(values, edges):
    return np.stack([np.histogram(row, edges)[0] for row in values])


def test_error_is_less_than_a_bin():
    edges = np.arange(0.0, 601.0)
    values = np.random.default_rng(0).normal([[90.0], [200.0]], [[3.0], [60.0]], (2, 2000)).clip(0, 599.9)
    found = quantiles_of_counts(edges, counted(values, edges))
    true = np.quantile(values, BAND_QUANTILES, axis=1, method="inverted_cdf")
    assert found.shape == (9, 2)
    assert np.abs(found - true).max() < 1.0


def test_quantiles_rise_and_shards_add_up():
    edges = np.linspace(0.0, 10.0, 41)
    values = np.random.default_rng(1).gamma(1.0, 1.0, (5, 600)).clip(0, 9.99)
    parts = sum(counted(part, edges) for part in np.array_split(values, 3, axis=1))
    whole = quantiles_of_counts(edges, counted(values, edges))
    np.testing.assert_array_equal(quantiles_of_counts(edges, parts), whole)
    assert (np.diff(whole, axis=0) >= 0.0).all()


def test_one_person_and_nobody():
    edges = np.array([0.0, 1.0, 2.0, 3.0])
    found = quantiles_of_counts(edges, np.array([[0, 1, 0], [0, 0, 0]]))
    assert ((found[:, 0] >= 1.0) & (found[:, 0] <= 2.0)).all()
    assert np.isnan(found[:, 1]).all()
