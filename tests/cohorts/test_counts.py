"""Quantiles of counts lie in the bin of the true ones."""

import numpy as np

from glucoloop.cohorts.counts import BAND_QUANTILES, quantiles_of_counts


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
