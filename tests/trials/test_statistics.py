"""Counts in bins against NumPy, quantiles of counts in the bin of the true ones, and exact quantiles against NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glucoloop.trials.statistics import (
    BAND_QUANTILES,
    Moments,
    bin_numbers,
    finite,
    glucose_edges,
    insulin_edges,
    quantiles,
    quantiles_of_counts,
)


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
    result = count(values, edges)
    assert result.dtype == np.int64
    np.testing.assert_array_equal(result, by_numpy(values, edges))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_lies_far_beyond_falls_in_the_outermost_bins(dtype):
    result = count(np.array([[-1e30, 1e30, 600.0, 599.9]], dtype), glucose_edges())
    assert result[0, 0] == 1
    assert result[0, -1] == 3
    assert result.sum() == 4


def test_a_value_on_an_edge_counts_above_it():
    result = count(np.array([[81.0, np.nextafter(81.0, 0.0), 0.0]]), glucose_edges())
    assert result[0, [0, 80, 81]].tolist() == [1, 1, 1]


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
    result = quantiles_of_counts(edges, counted(values, edges))
    true = np.quantile(values, BAND_QUANTILES, axis=1, method="inverted_cdf")
    assert result.shape == (9, 2)
    assert np.abs(result - true).max() < 1.0


def test_quantiles_rise_and_shards_add_up():
    edges = np.linspace(0.0, 10.0, 41)
    values = np.random.default_rng(1).gamma(1.0, 1.0, (5, 600)).clip(0, 9.99)
    parts = sum(counted(part, edges) for part in np.array_split(values, 3, axis=1))
    whole = quantiles_of_counts(edges, counted(values, edges))
    np.testing.assert_array_equal(quantiles_of_counts(edges, parts), whole)
    assert (np.diff(whole, axis=0) >= 0.0).all()


def test_one_person_and_nobody():
    edges = np.array([0.0, 1.0, 2.0, 3.0])
    result = quantiles_of_counts(edges, np.array([[0, 1, 0], [0, 0, 0]]))
    assert ((result[:, 0] >= 1.0) & (result[:, 0] <= 2.0)).all()
    assert np.isnan(result[:, 1]).all()


PROBABILITIES = (0.0, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 1.0)


def check(values, parts):
    def read():
        for part in np.array_split(values, parts):
            yield [part]

    moments, known = Moments(), finite(values)
    for [part] in read():
        moments.add(finite(part))
    assert moments.count == known.size
    of = quantiles(read, [moments.count], PROBABILITIES)[0]
    if not known.size:
        assert np.isnan(of).all()
        return
    assert (moments.least, moments.greatest) == (known.min(), known.max())
    scale = max(np.abs(known).max(), 1e-300)
    np.testing.assert_allclose(of, np.quantile(known, PROBABILITIES), rtol=0.0, atol=1e-15 * scale)
    np.testing.assert_allclose(moments.mean, known.mean(), rtol=0.0, atol=1e-12 * scale)
    if known.size > 1:
        np.testing.assert_allclose(moments.sd, known.std(ddof=1), rtol=1e-9, atol=1e-12 * scale)


numbers = st.one_of(st.floats(-1e100, 1e100), st.sampled_from([0.0, 1.0, np.nan, np.inf, -np.inf, 1e-300]))


@given(hnp.arrays(float, st.integers(1, 60), elements=numbers), st.integers(1, 5))
def test_few_numbers(values, parts):
    check(values, parts)


MANY = 100_000
LAWS = {
    "spread evenly": lambda rng: rng.random(MANY),
    "nearly all the same": lambda rng: np.where(rng.random(MANY) < 0.97, 0.0, rng.random(MANY)),
    "all the same": lambda rng: np.full(MANY, 3.0),
    "whole numbers": lambda rng: rng.integers(0, 4, MANY).astype(float),
    "far tails": lambda rng: rng.standard_cauchy(MANY) ** 5,
    "apart by rounding": lambda rng: 1.0 + 1e-16 * rng.integers(0, 9, MANY),
    "two heaps": lambda rng: np.where(rng.random(MANY) < 0.5, 1e-12 * rng.random(MANY), 1e9 + rng.random(MANY)),
    "falling": lambda rng: np.sort(rng.random(MANY))[::-1],
    "far below at first": lambda rng: np.concatenate([np.zeros(MANY // 2), 1.0 + rng.random(MANY // 2)]),
    "some missing": lambda rng: np.where(rng.random(MANY) < 0.1, np.nan, rng.normal(size=MANY)),
}


@pytest.mark.parametrize("law", LAWS)
def test_many_numbers(law):
    check(LAWS[law](np.random.default_rng(1)), 7)


def test_columns_are_apart():
    rng = np.random.default_rng(2)
    values = rng.normal(size=(3, 1000))
    parts = [[column[:300] for column in values], [column[300:] for column in values]]
    result = quantiles(lambda: parts, [1000] * 3, PROBABILITIES)
    np.testing.assert_allclose(result, np.quantile(values, PROBABILITIES, axis=1).T, rtol=1e-14)
