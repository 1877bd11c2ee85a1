"""The covariance that a filter carries along, against SciPy's Riccati equation."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.estimation import riccati_step
from glucoloop.estimation.riccati import RICCATI_STEPS, is_covariance, next_covariance, triangle, whole


def a_model(seed, n=6, radius=0.95):
    rng = np.random.default_rng(seed)
    Phi = rng.normal(size=(n, n))
    Phi *= radius / np.abs(np.linalg.eigvals(Phi)).max()
    return Phi, rng.normal(size=n), np.diag(rng.uniform(0.1, 1.0, n)), 1.45


def steady(Phi, C, Q, R):
    return scipy.linalg.solve_discrete_are(Phi.T, C[:, None], Q, np.array([[R]]))


@pytest.mark.long
@pytest.mark.parametrize("n", [1, 2, 3, 20])
def test_the_triangle_is_the_whole(n):
    root = np.random.default_rng(n).normal(size=(n, n))
    P = root @ root.T
    packed = triangle(jnp.asarray(P))
    assert packed.shape == (n * (n + 1) // 2,)
    np.testing.assert_array_equal(whole(packed), np.tril(P) + np.tril(P, -1).T)


@pytest.mark.parametrize("seed", range(4))
def test_it_takes_steps_of_the_riccati_equation(seed):
    Phi, C, Q, R = a_model(seed)
    P = expected = np.eye(6) * 3.0
    for _ in range(RICCATI_STEPS):
        expected = riccati_step(expected, Phi, C, Q, R)
    np.testing.assert_allclose(whole(next_covariance(triangle(jnp.asarray(P)), Phi, C, Q, R)), expected, rtol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_it_comes_to_rest_at_the_steady_covariance_and_follows_a_model_that_changes(seed):
    Phi, C, Q, R = a_model(seed)
    packed = triangle(jnp.asarray(steady(Phi, C, Q, R)))
    np.testing.assert_allclose(next_covariance(packed, Phi, C, Q, R), packed, rtol=1e-9, atol=1e-9)
    other = 0.9 * Phi
    away = np.abs(whole(packed) - steady(other, C, Q, R)).max()
    for _ in range(8):
        packed = next_covariance(packed, other, C, Q, R)
    assert np.abs(whole(packed) - steady(other, C, Q, R)).max() < 1e-3 * away


@settings(deadline=None)
@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=6, max_size=6))
def test_what_is_no_covariance_is_told(numbers):
    found = bool(is_covariance(jnp.asarray(numbers)))
    assert found == (bool(np.isfinite(numbers).all()) and min(numbers[0], numbers[2], numbers[5]) >= 0.0)
