"""Quantiles of numbers that come in parts are those that NumPy finds in all of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from glucoloop.trials.order_statistics import Moments, finite, quantiles

PROBABILITIES = (0.0, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 1.0)


def check(values, parts):
    def read():
        for part in np.array_split(values, parts):
            yield [part]

    found, known = Moments(), finite(values)
    for [part] in read():
        found.add(finite(part))
    assert found.count == known.size
    of = quantiles(read, [found.count], PROBABILITIES)[0]
    if not known.size:
        assert np.isnan(of).all()
        return
    assert (found.least, found.greatest) == (known.min(), known.max())
    scale = max(np.abs(known).max(), 1e-300)
    np.testing.assert_allclose(of, np.quantile(known, PROBABILITIES), rtol=0.0, atol=1e-15 * scale)
    np.testing.assert_allclose(found.mean, known.mean(), rtol=0.0, atol=1e-12 * scale)
    if known.size > 1:
        np.testing.assert_allclose(found.sd, known.std(ddof=1), rtol=1e-9, atol=1e-12 * scale)


numbers = st.one_of(st.floats(-1e100, 1e100), st.sampled_from([0.0, 1.0, np.nan, np.inf, -np.inf, 1e-300]))


@given(arrays(float, st.integers(1, 60), elements=numbers), st.integers(1, 5))
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
    found = quantiles(lambda: parts, [1000] * 3, PROBABILITIES)
    np.testing.assert_allclose(found, np.quantile(values, PROBABILITIES, axis=1).T, rtol=1e-14)
