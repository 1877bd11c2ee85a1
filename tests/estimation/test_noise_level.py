"""Filters for correlated noise against the normal distribution of a whole record, and what they learn from it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.estimation.noise_level import LEVELS_MG_DL, noisy_filters

PHI, C, Q, R = np.array([[0.9, 0.3], [0.0, 1.0]]), np.array([1.0, 0.0]), np.diag([0.0, 0.05]), 1.45
FILTERS = noisy_filters(PHI, C, Q, R)
learn = jax.jit(lambda filters, noise, innovation, known: filters.learn(noise, innovation, known))


def test_each_gain_gives_the_mean_of_the_state_given_the_whole_record():
    """The conditional mean of a normal distribution, with the covariance of all readings written out."""
    N, c = 320, 0.7
    rng = np.random.default_rng(0)
    powers = [np.linalg.matrix_power(PHI, k) for k in range(N)]
    start = np.eye(2)
    x_cov = np.zeros((N, N, 2, 2))
    P = start
    for i in range(N):
        for j in range(i, N):
            x_cov[j, i] = powers[j - i] @ P
            x_cov[i, j] = x_cov[j, i].T
        P = PHI @ P @ PHI.T + Q
    apart = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    for level, deviation in enumerate(LEVELS_MG_DL):
        noise = R * np.eye(N) + deviation**2 * c**apart
        readings = rng.normal(size=N)
        y_cov = np.einsum("i,jkil,l->jk", C, x_cov, C) + noise
        exact = np.einsum("jil,l->ij", x_cov[-1], C) @ np.linalg.solve(y_cov, readings)
        gain, x, e = np.asarray(FILTERS.gain[level]), np.zeros(2), 0.0
        for reading in readings:
            x, e = PHI @ x, c * e
            innovation = reading - C @ x - e
            x, e = x + gain[:2] * innovation, e + gain[2] * innovation
        np.testing.assert_allclose(x, exact, atol=1e-6)


def test_at_no_correlated_noise_it_is_the_filter_for_white_noise():
    assert float(FILTERS.gain[0, -1]) == 0.0
    gain, variance = FILTERS.at(jnp.zeros(()))
    np.testing.assert_array_equal(gain, FILTERS.gain[0])
    assert float(variance) == float(FILTERS.innovation_variance[0])


def test_between_two_designs_the_gain_is_interpolated():
    gain, _ = FILTERS.at(jnp.asarray(2.25))
    np.testing.assert_allclose(gain, 0.75 * FILTERS.gain[2] + 0.25 * FILTERS.gain[3], rtol=1e-14)


def test_a_known_size_stays():
    fixed = FILTERS.fixed(2.25)
    for deviation in (0.0, 5.5):
        np.testing.assert_allclose(fixed.at(jnp.asarray(deviation))[0], FILTERS.at(jnp.asarray(2.25))[0], rtol=1e-14)
    assert float(fixed.learn(jnp.asarray(1.0), jnp.asarray(-8.0), jnp.asarray(True))) == 1.0


def learned(deviation, samples=4000, seed=1):
    """Sizes that the filter learns from a record of the model with correlated noise."""
    rng = np.random.default_rng(seed)
    shocks = rng.normal(size=(samples, 3)) * [np.sqrt(0.05), np.sqrt(1.0 - 0.49) * deviation, np.sqrt(R)]

    def sample(carry, shock):
        x, e, guess, error, noise = carry
        x, e = PHI @ x + jnp.array([0.0, 1.0]) * shock[0], 0.7 * e + shock[1]
        guess, error = PHI @ guess, 0.7 * error
        innovation = x[0] + e + shock[2] - guess[0] - error
        gain, variance = FILTERS.at(noise)
        noise = FILTERS.learn(noise, innovation / jnp.sqrt(variance), jnp.asarray(True))
        return (x, e, guess + gain[:2] * innovation, error + gain[2] * innovation, noise), noise

    none = jnp.zeros(())
    start = (jnp.zeros(2), none, jnp.zeros(2), none, none)
    return np.asarray(jax.jit(lambda: jax.lax.scan(sample, start, jnp.asarray(shocks))[1])())


def test_the_size_of_the_noise_is_learned():
    white, little, much = (learned(deviation) for deviation in (0.0, 2.0, 4.0))
    assert white.mean() < 0.8
    assert little.mean() == pytest.approx(2.0, abs=0.5)
    assert much.mean() == pytest.approx(4.0, abs=0.7)
    # and within two hours
    assert much[24:48].mean() > 2.0


def test_what_raises_glucose_is_not_noise():
    noise = jnp.zeros(())
    for innovation in (0.5, 3.0, 8.0, 9.0, 4.0):
        noise = learn(FILTERS, noise, jnp.asarray(innovation), jnp.asarray(True))
    assert float(noise) == 0.0


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.booleans()), max_size=40))
@settings(max_examples=50)
def test_any_innovations_leave_a_size_within_the_designs(innovations):
    noise = jnp.zeros(())
    for innovation, known in innovations:
        noise = learn(FILTERS, noise, jnp.asarray(innovation), jnp.asarray(known))
        assert LEVELS_MG_DL[0] <= float(noise) <= LEVELS_MG_DL[-1]


@pytest.mark.parametrize(
    ("bad", "sentence"),
    [
        ({"correlation": 1.0}, "a correlation of 1 is not possible; give 0 or more and less than 1"),
        ({"pace": -0.1}, "a pace of -0.1 mg/dl per innovation is not possible; give 0 to 1"),
    ],
)
def test_a_design_that_is_not_possible_is_refused(bad, sentence):
    with pytest.raises(ValueError, match=sentence):
        noisy_filters(PHI, C, Q, R, **bad)
