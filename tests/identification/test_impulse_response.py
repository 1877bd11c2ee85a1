"""Both estimators against known systems, and their noise against its closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import signal

from glucoloop.identification import cross_correlation, design_csrs, least_squares, random_binary_sequence

MEMORY = 8
responses = arrays(float, MEMORY, elements=st.floats(-10, 10, allow_subnormal=False))


def glucose_of(h, u):
    """N + 1 readings of a finite impulse response, from rest."""
    return signal.lfilter(np.r_[0.0, h], [1.0], np.r_[u, 0.0])


@pytest.mark.long
@settings(deadline=None, max_examples=30)
@given(responses, st.sampled_from([(None, None), (40, None), (None, 6)]), st.floats(-100, 100))
def test_cross_correlation_recovers_a_finite_response_whatever_the_baseline(h, size, baseline):
    u = np.asarray(design_csrs(MEMORY, 4.0, *size))
    np.testing.assert_allclose(cross_correlation(u, glucose_of(h, u) + baseline, MEMORY), h, atol=1e-10)


def test_cross_correlation_on_the_shortest_record_is_half_the_difference_of_the_two_answers():
    y = np.random.default_rng(0).normal(size=73)
    h = cross_correlation(design_csrs(36, 22.33), y, 36)
    np.testing.assert_allclose(h, (y[1:37] - y[37:73]) / (2 * 22.33), rtol=1e-13)


@settings(deadline=None, max_examples=30)
@given(responses, st.integers(0, 1000))
def test_least_squares_recovers_a_finite_response_from_a_white_input(h, seed):
    u = np.random.default_rng(seed).normal(size=60)
    np.testing.assert_allclose(least_squares(u, glucose_of(h, u), MEMORY), h, atol=1e-9)


@pytest.mark.long
def test_least_squares_recovers_the_response_beside_an_unknown_baseline_and_an_unknown_past():
    rng = np.random.default_rng(3)
    h, u = rng.normal(size=MEMORY), rng.normal(size=90)
    y = glucose_of(h, u) + 7.0
    np.testing.assert_allclose(least_squares(u, y, MEMORY, free_baseline=True), h, atol=1e-10)
    tail = least_squares(u[30:], y[30:], MEMORY, free_baseline=True, starts_at_rest=False)
    np.testing.assert_allclose(tail, h, atol=1e-10)
    assert np.abs(least_squares(u[30:], y[30:], MEMORY, free_baseline=True) - h).max() > 1e-3


def test_least_squares_is_the_normal_equations_and_no_other_response_fits_better():
    rng = np.random.default_rng(4)
    u, y = rng.normal(size=50), rng.normal(size=51)
    columns = np.column_stack([np.r_[np.zeros(i), u][: len(y) - 1] for i in range(MEMORY)])
    expected = np.linalg.solve(columns.T @ columns, columns.T @ y[1:])
    np.testing.assert_allclose(least_squares(u, y, MEMORY), expected, atol=1e-12)


def test_both_estimates_are_one_on_a_switching_sequence():
    u = np.asarray(design_csrs(MEMORY, 2.0, pulses=6))
    y = np.random.default_rng(5).normal(size=u.size + 1)
    np.testing.assert_allclose(least_squares(u, y, MEMORY), cross_correlation(u, y, MEMORY), atol=1e-12)


@pytest.mark.parametrize("estimator", [cross_correlation, least_squares])
def test_noise_is_unbiased_white_and_falls_with_the_power_of_the_input(estimator):
    u = design_csrs(MEMORY, 3.0, pulses=4)
    h = np.linspace(1.0, 0.1, MEMORY)
    noise = 1.2 * jax.random.normal(jax.random.key(0), (4000, u.size + 1))
    estimates = jax.vmap(lambda e: estimator(u, jnp.asarray(glucose_of(h, np.asarray(u))) + e, MEMORY))(noise)
    variance = 1.2**2 / float(u @ u)  # h_i averages as many readings as there are pulses
    errors = np.asarray(estimates) - h
    assert np.abs(errors.mean(axis=0)).max() < 5 * np.sqrt(variance / 4000)
    np.testing.assert_allclose(np.cov(errors.T), variance * np.eye(MEMORY), atol=0.1 * variance)


@pytest.mark.parametrize("estimator", [cross_correlation, least_squares])
def test_realisations_as_columns_vmapped_or_jitted_are_those_one_at_a_time(estimator):
    u = design_csrs(MEMORY, 3.0, pulses=4)
    y = np.random.default_rng(6).normal(size=(u.size + 1, 5))
    one_by_one = np.column_stack([estimator(u, y[:, r], MEMORY) for r in range(5)])
    np.testing.assert_allclose(estimator(u, y, MEMORY), one_by_one, atol=1e-12)
    vmapped = jax.vmap(lambda column: estimator(u, column, MEMORY), in_axes=1, out_axes=1)(y)
    np.testing.assert_allclose(vmapped, one_by_one, atol=1e-12)
    inputs_too = jax.jit(jax.vmap(lambda a, b: estimator(a, b, MEMORY)))(jnp.tile(u, (5, 1)), y.T)
    np.testing.assert_allclose(inputs_too.T, one_by_one, atol=1e-12)


@pytest.mark.parametrize("estimator", [cross_correlation, least_squares])
@pytest.mark.parametrize(
    ("u", "y", "memory", "sentence"),
    [
        (np.ones(5), np.ones(5), 2, "5 insulin samples need 6 glucose readings"),
        (np.ones((5, 2)), np.ones(6), 2, r"shape \(5, 2\) is not a one-dimensional"),
        (np.ones(0), np.ones(1), 2, r"shape \(0,\)"),
        (np.array([1, np.nan, 1.0]), np.ones(4), 2, "insulin rates are not finite at sample 1"),
        (np.ones(3), np.array([1, 1, 1, np.inf]), 2, "glucose readings are not finite at sample 3"),
        (np.ones(3), np.ones(4), 0, "memory is 0: it must be a whole number of at least 1"),
        (np.ones(3), np.ones(4), 1.5, "memory is 1.5"),
    ],
)
def test_records_that_do_not_pair_up_are_refused(estimator, u, y, memory, sentence):
    with pytest.raises(ValueError, match=sentence):
        estimator(u, y, memory)


def test_an_input_that_never_moves_is_refused():
    with pytest.raises(ValueError, match=r"never leaves its steady rate.*design_csrs"):
        cross_correlation(np.zeros(20), np.zeros(21), 4)


@pytest.mark.long
@pytest.mark.parametrize(
    ("samples", "keywords", "least"),
    [
        (7, {}, 8),
        (7, {"free_baseline": True}, 8),
        (14, {"starts_at_rest": False}, 15),
        (15, {"starts_at_rest": False, "free_baseline": True}, 16),
    ],
)
def test_a_record_too_short_for_the_memory_is_refused_and_the_least_one_is_not(samples, keywords, least):
    rng = np.random.default_rng(7)
    with pytest.raises(ValueError, match=rf"{samples} samples is too short for 8 coefficients: at least {least}"):
        least_squares(rng.normal(size=samples), np.zeros(samples + 1), MEMORY, **keywords)
    u, h = rng.normal(size=least), rng.normal(size=MEMORY)
    np.testing.assert_allclose(least_squares(u, glucose_of(h, u), MEMORY, **keywords), h, atol=1e-6)


def test_an_input_that_does_not_excite_every_coefficient_is_refused():
    slow = np.sin(2 * np.pi * np.arange(60) / 20)
    with pytest.raises(ValueError, match=r"excites only 2 of the 8 coefficients.*shorten the memory"):
        least_squares(slow, np.zeros(61), MEMORY, starts_at_rest=False)
    late = np.r_[np.zeros(57), 1.0, -1.0, 1.0]
    with pytest.raises(ValueError, match="excites only 3 of the 8"):
        least_squares(late, np.zeros(61), MEMORY)


def test_a_constant_input_cannot_be_told_from_a_baseline():
    with pytest.raises(ValueError, match="excites only 0 of the 8"):
        least_squares(np.ones(60), np.zeros(61), MEMORY, starts_at_rest=False, free_baseline=True)


def test_a_random_binary_sequence_excites_the_whole_memory_of_the_paper():
    u = np.asarray(random_binary_sequence(100, 2.233, seed=0))
    h = -0.02 * 0.9 ** np.arange(36)
    np.testing.assert_allclose(least_squares(u, glucose_of(h, u), 36), h, atol=1e-9)
