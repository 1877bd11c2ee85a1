"""Laguerre functions against their z-transform, their orthogonality, and projection's own laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import signal

from glucoloop.identification import (
    best_pole,
    laguerre_coefficients,
    laguerre_functions,
    laguerre_realisation,
    laguerre_smooth,
)
from glucoloop.identification.laguerre import laguerre_sum

poles = st.floats(0.05, 0.95)
responses = arrays(float, 36, elements=st.floats(-1, 1, allow_subnormal=False))


@settings(deadline=None, max_examples=30)
@given(poles)
def test_functions_are_the_impulse_responses_of_the_laguerre_network(pole):
    # sqrt(1-a^2)/(1 - a/z) followed by the all-pass (1/z - a)/(1 - a/z), once more for each function.
    functions = np.asarray(laguerre_functions(pole, 5, 36))
    impulse = np.r_[1.0, np.zeros(35)]
    expected = signal.lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], impulse)
    for function in functions:
        np.testing.assert_allclose(function, expected, atol=1e-10)
        expected = signal.lfilter([-pole, 1.0], [1.0, -pole], expected)


@settings(deadline=None, max_examples=15)
@given(st.floats(0.05, 0.9))
def test_functions_are_orthonormal_over_a_long_memory(pole):
    functions = np.asarray(laguerre_functions(pole, 6, 600))
    np.testing.assert_allclose(functions @ functions.T, np.eye(6), atol=1e-9)


@settings(deadline=None, max_examples=20)
@given(poles, st.floats(-5, 5))
def test_a_first_order_decay_is_one_laguerre_function_with_its_pole(pole, size):
    decay = size * pole ** np.arange(36)
    np.testing.assert_allclose(laguerre_smooth(decay, pole, 1), decay, atol=1e-11)
    np.testing.assert_allclose(laguerre_coefficients(decay, pole, 1), [size / np.sqrt(1 - pole**2)], atol=1e-10)


def test_a_critically_damped_response_needs_two_functions():
    response = np.arange(1, 37) * 0.8 ** np.arange(36)
    np.testing.assert_allclose(laguerre_smooth(response, 0.8, 2), response, atol=1e-11)
    assert np.abs(laguerre_smooth(response, 0.8, 1) - response).max() > 0.1


@settings(deadline=None, max_examples=25)
@given(responses, poles)
def test_smoothing_is_an_orthogonal_projection_that_improves_with_every_function(h, pole):
    errors = []
    for functions in (1, 2, 4):
        smooth = np.asarray(laguerre_smooth(h, pole, functions))
        np.testing.assert_allclose(laguerre_smooth(smooth, pole, functions), smooth, atol=1e-9)
        np.testing.assert_allclose(np.asarray(laguerre_functions(pole, functions, 36)) @ (h - smooth), 0, atol=1e-9)
        errors.append(np.linalg.norm(h - smooth))
    assert errors[0] >= errors[1] - 1e-9
    assert errors[1] >= errors[2] - 1e-9


def test_as_many_functions_as_coefficients_leave_nothing():
    h = np.random.default_rng(0).normal(size=10)
    np.testing.assert_allclose(laguerre_smooth(h, 0.3, 10), h, atol=1e-8)


def test_smoothing_keeps_of_white_noise_only_its_share_of_the_dimensions():
    noise = np.asarray(jax.random.normal(jax.random.key(1), (36, 4000)))
    kept = (np.asarray(laguerre_smooth(noise, 0.84, 2)) ** 2).sum(axis=0).mean()
    assert kept == pytest.approx(2.0, rel=0.06)  # of 36; its standard error over 4000 draws is .03


@pytest.mark.parametrize("pole", [0.35, 0.84, 0.97])
def test_the_best_pole_of_a_decay_is_its_own(pole):
    search = best_pole(pole ** np.arange(36), 1)
    assert search.pole == pytest.approx(pole)
    assert search.residual_norm < 1e-9
    assert search.poles.shape == search.residual_norms.shape == (99,)


@pytest.mark.long
@settings(deadline=None, max_examples=10)
@given(responses, st.sampled_from([1, 2, 3]))
def test_the_error_curve_is_that_of_each_pole_and_its_least_is_returned(h, functions):
    search = best_pole(h, functions, [0.5, 0.7, 0.9])
    expected = [np.linalg.norm(h - laguerre_smooth(h, a, functions)) for a in (0.5, 0.7, 0.9)]
    np.testing.assert_allclose(search.residual_norms, expected, atol=1e-9)
    assert search.residual_norm == search.residual_norms.min()
    assert search.residual_norms[jnp.argmax(search.poles == search.pole)] == search.residual_norm


@pytest.mark.long
def test_columns_and_vmapped_responses_agree_with_one_at_a_time():
    h = np.random.default_rng(2).normal(size=(36, 4))
    one_by_one = np.column_stack([laguerre_smooth(h[:, r], 0.84, 2) for r in range(4)])
    np.testing.assert_allclose(laguerre_smooth(h, 0.84, 2), one_by_one, atol=1e-12)
    vmapped = jax.vmap(lambda column: laguerre_smooth(column, 0.84, 2), in_axes=1, out_axes=1)
    np.testing.assert_allclose(vmapped(h), one_by_one, atol=1e-12)
    searched = jax.jit(jax.vmap(lambda column: best_pole(column, 2).pole, in_axes=1))(h)
    np.testing.assert_allclose(searched, [best_pole(h[:, r], 2).pole for r in range(4)])
    over_poles = jax.vmap(lambda a: laguerre_smooth(h[:, 0], a, 2))(jnp.array([0.5, 0.84]))
    np.testing.assert_allclose(over_poles[1], one_by_one[:, 0], atol=1e-12)


@pytest.mark.parametrize("pole", [0.0, 1.0, -0.5, 1.2, np.nan])
def test_a_pole_outside_the_unit_interval_is_refused(pole):
    for refused in (
        lambda: laguerre_functions(pole, 2, 36),
        lambda: laguerre_smooth(np.ones(36), pole, 2),
        lambda: best_pole(np.ones(36), 2, [0.5, pole]),
    ):
        with pytest.raises(ValueError, match=r"not strictly between 0 and 1.*exp"):
            refused()


@pytest.mark.parametrize(
    ("refused", "sentence"),
    [
        (lambda: laguerre_functions(0.84, 0, 36), "number of Laguerre functions is 0"),
        (lambda: laguerre_functions(0.84, 37, 36), "37 Laguerre functions are more than the 36 .*at most 36"),
        (lambda: laguerre_functions(0.84, 2, 0), "memory is 0"),
        (lambda: laguerre_coefficients([], 0.84, 2), "no coefficient"),
        (lambda: laguerre_coefficients([1.0, np.nan, 1.0], 0.84, 2), "coefficients are not finite at sample 1"),
        (lambda: best_pole(np.ones(36), 2, []), "grid of Laguerre poles is empty"),
        (lambda: best_pole(np.ones((36, 2)), 2), "not one-dimensional.*vmap"),
    ],
)
def test_what_has_no_projection_is_refused(refused, sentence):
    with pytest.raises(ValueError, match=sentence):
        refused()


@settings(deadline=None, max_examples=20)
@given(st.floats(0.95, 0.97), st.floats(-5, -0.1))
def test_a_first_order_decay_goes_on_as_it_was(pole, size):
    coefficients = laguerre_coefficients(size * pole ** np.arange(36), pole, 3)
    later = laguerre_realisation(coefficients, pole, 36).advanced(36)
    h = later.output @ later.states(100)
    np.testing.assert_allclose(h, size * pole ** np.arange(36, 136), atol=1e-8)


def test_a_realisation_is_the_functions_and_what_they_sum_to():
    pole, coefficients = 0.98, np.array([-0.9, -0.5, -0.2, 0.1])
    realisation = laguerre_realisation(coefficients, pole, 200)
    h = coefficients @ np.asarray(laguerre_functions(pole, 4, 4000))
    np.testing.assert_allclose(realisation.output @ realisation.states(4000), h, atol=1e-12)
    np.testing.assert_allclose(realisation.sum, coefficients.sum() * laguerre_sum(pole), rtol=1e-9)


@settings(deadline=None, max_examples=20)
@given(arrays(float, 2, elements=st.floats(-5, -0.01)))
def test_the_published_patients_response_has_died_out_within_its_memory(coefficients):
    assert laguerre_realisation(coefficients, 0.84, 36) is None
