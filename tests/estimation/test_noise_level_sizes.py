"""Innovations under every size of the sensor's error: closed forms, a simulated sensor, and sizes that are learned."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from glucoloop.estimation.noise_level import (
    CORRELATION,
    LEVELS_MG_DL,
    drifting,
    innovations_of,
    mean_size,
    noisy_filters,
)

PHI, C, Q, R = np.array([[0.9, 0.3], [0.0, 1.0]]), np.array([1.0, 0.0]), np.diag([0.0, 0.05]), 1.45
FILTERS = noisy_filters(PHI, C, Q, R)
INNOVATIONS = innovations_of(FILTERS, PHI, C, Q, R)


def innovations(used, true, samples, seed):
    """Innovations of the filter for one size while a sensor has another, sample by sample."""
    drives = np.sqrt([Q[1, 1], (1.0 - CORRELATION**2) * LEVELS_MG_DL[true] ** 2, R])
    gain, drawn = np.asarray(FILTERS.gain[used]), np.random.default_rng(seed).normal(size=(samples, 3)) * drives
    truth, error, x, e, found = np.zeros(2), 0.0, np.zeros(2), 0.0, []
    for disturbed, enters, noise in drawn:
        truth, error = PHI @ truth + np.array([0.0, disturbed]), CORRELATION * error + enters
        x, e = PHI @ x, CORRELATION * e
        innovation = C @ truth + error + noise - C @ x - e
        x, e = x + gain[:2] * innovation, e + gain[2] * innovation
        found.append(innovation)
    return np.array(found)


def test_where_the_size_is_right_innovations_are_independent_with_the_variance_of_the_design():
    np.testing.assert_allclose(np.diag(INNOVATIONS.variance), FILTERS.innovation_variance, rtol=1e-6)
    np.testing.assert_allclose(np.diag(INNOVATIONS.correlation), 0.0, atol=1e-6)


@pytest.mark.parametrize(("used", "true"), [(0, 3), (3, 0), (2, 5)])
def test_where_it_is_wrong_they_are_those_of_a_simulated_sensor(used, true):
    found = innovations(used, true, 40_000, seed=5)[200:]
    correlation = np.corrcoef(found[1:], found[:-1])[0, 1]
    assert np.var(found) == pytest.approx(float(INNOVATIONS.variance[used, true]), rel=0.04)
    assert correlation == pytest.approx(float(INNOVATIONS.correlation[used, true]), abs=0.02)
    assert abs(correlation) > 0.1


@pytest.mark.parametrize("deviation", [0.0, 2.25, 6.0])
def test_the_likelihood_is_the_normal_density_given_the_innovation_before(deviation):
    innovation, before = jnp.asarray([2.0, -4.0, 0.3]), jnp.asarray([1.0, 3.0, -2.0])
    found = INNOVATIONS.likelihood(jnp.asarray(deviation), innovation, before, 0.0)
    low = int(deviation)
    share = deviation - low
    for level in range(len(LEVELS_MG_DL)):
        S, rho = (
            (1.0 - share) * table[low, level] + share * table[min(low + 1, 6), level]
            for table in (INNOVATIONS.variance, INNOVATIONS.correlation)
        )
        expected = norm.pdf(innovation, rho * before, np.sqrt(S * (1.0 - rho**2))) * np.sqrt(2.0 * np.pi)
        np.testing.assert_allclose(found[level], expected, rtol=1e-9)


@pytest.mark.parametrize(("true", "least", "most"), [(0, 0.0, 0.7), (3, 2.0, 4.0), (6, 4.7, 6.0)])
def test_an_hour_and_a_half_of_readings_tells_the_size(true, least, most):
    learned = []
    for seed in range(20):
        p, before = np.full((7, 1), 1.0 / 7.0), 0.0
        for innovation in innovations(2, true, 38, seed)[20:]:
            p = drifting(0.01) @ p * INNOVATIONS.likelihood(jnp.asarray(2.0), innovation, before, 1e-3)
            p, before = p / np.sum(p), innovation
        learned.append(float(mean_size(jnp.asarray(p))))
    assert least <= np.median(learned) <= most


@given(st.floats(0.0, 1.0))
def test_a_drift_keeps_probabilities(rate):
    passed = drifting(rate)
    np.testing.assert_allclose(passed.sum(axis=0), 1.0, rtol=1e-12)
    assert (passed >= 0.0).all()


def test_a_known_size_has_independent_innovations_of_one_variance():
    fixed = INNOVATIONS.fixed(jnp.asarray(2.0))
    likelihood = fixed.likelihood(jnp.asarray(3.3), jnp.asarray([1.0]), jnp.asarray([5.0]), 0.0)
    np.testing.assert_allclose(likelihood, np.exp(-0.25) / np.sqrt(2.0), rtol=1e-12)
