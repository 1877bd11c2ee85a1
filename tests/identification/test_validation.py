"""Validation on data with a known error, and the sequence it uses."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.identification import random_binary_sequence, validate
from glucoloop.models.step_response import StepResponseModel

MODEL = StepResponseModel.from_impulse_response(-0.1 * 0.8 ** np.arange(12), 5.0)
INSULIN = np.asarray(random_binary_sequence(50, 2.0, seed=3))


def test_a_perfect_model_fits_perfectly():
    result = validate(MODEL, INSULIN, MODEL.predict(INSULIN))
    assert result.fit_percent == 100
    assert result.sum_absolute_residual_mg_dl == 0
    assert result.worst_residual_mg_dl == 0


def test_a_known_error_is_told_as_it_is():
    error = np.zeros(51)
    error[[4, 20, 33]] = 1.0, -3.0, 0.5
    truth = np.asarray(MODEL.predict(INSULIN))
    result = validate(MODEL, INSULIN, truth + error)
    np.testing.assert_allclose(result.residuals_mg_dl, error, atol=1e-12)
    assert result.sum_absolute_residual_mg_dl == pytest.approx(4.5)
    assert result.worst_residual_mg_dl == pytest.approx(3.0)
    spread = np.std(truth + error) * np.sqrt(51)
    assert result.fit_percent == pytest.approx(100 * (1 - np.linalg.norm(error) / spread))


def test_a_model_without_response_fits_no_better_than_the_mean():
    y = np.asarray(MODEL.predict(INSULIN))
    nothing = StepResponseModel.from_impulse_response(np.zeros(12), 5.0)
    assert validate(nothing, INSULIN, y - y.mean()).fit_percent == pytest.approx(0.0, abs=1e-9)


@settings(deadline=None, max_examples=20)
@given(st.floats(0.1, 3.0))
def test_a_gain_error_shows_in_proportion(gain):
    y = MODEL.predict(INSULIN)
    result = validate(MODEL, INSULIN, gain * y)
    assert result.sum_absolute_residual_mg_dl == pytest.approx(abs(gain - 1) * float(np.abs(y).sum()), abs=1e-9)


def test_validation_of_many_records_at_once_is_that_of_each():
    noise = np.random.default_rng(0).normal(size=(3, 51))
    together = jax.vmap(lambda e: validate(MODEL, INSULIN, e).fit_percent)(noise)
    np.testing.assert_allclose(together, [validate(MODEL, INSULIN, e).fit_percent for e in noise])


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 300), st.integers(0, 10_000), st.integers(1, 8))
def test_a_random_binary_sequence_has_two_levels_and_holds_each_draw(samples, seed, hold):
    u = np.asarray(random_binary_sequence(samples, 2.233, seed, hold_samples=hold))
    assert u.size == samples
    assert set(np.abs(u)) == {2.233}
    changes = np.flatnonzero(np.diff(u)) + 1
    assert (changes % hold == 0).all()
    np.testing.assert_array_equal(u, random_binary_sequence(samples, 2.233, seed, hold_samples=hold))


def test_both_levels_are_equally_likely_and_draws_independent():
    u = np.asarray(random_binary_sequence(20_000, 1.0, seed=0))
    assert abs(u.mean()) < 0.03  # four standard errors
    assert abs((u[1:] * u[:-1]).mean()) < 0.03
    assert (u != np.asarray(random_binary_sequence(20_000, 1.0, seed=1))).any()


@pytest.mark.parametrize(
    ("refused", "sentence"),
    [
        (lambda: random_binary_sequence(0, 1.0, 0), "number of samples is 0"),
        (lambda: random_binary_sequence(10, -1.0, 0), "amplitude is -1.0 mU/min"),
        (lambda: random_binary_sequence(10, 1.0, 0, hold_samples=0), "hold is 0"),
        (lambda: validate(MODEL, INSULIN, np.zeros(50)), "50 insulin samples need 51 glucose readings"),
        (lambda: validate(MODEL, INSULIN, np.zeros((51, 2))), "not one-dimensional: use jax.vmap"),
        (lambda: validate(MODEL, INSULIN, np.full(51, 3.0)), "All readings are 3.0 mg/dl"),
        (lambda: validate(MODEL, INSULIN, np.full(51, np.nan)), "readings are not finite at sample 0"),
    ],
)
def test_what_cannot_be_validated_is_refused(refused, sentence):
    with pytest.raises(ValueError, match=sentence):
        refused()
