"""Step-response model against SciPy's filter and simulator, and its own definition."""

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import signal

from glucoloop.models.step_response import Realisation, StepResponseModel, extended, lagged_inputs

values = st.floats(-50, 50, allow_subnormal=False)
impulse_responses = arrays(float, 12, elements=values)
inputs = arrays(float, 40, elements=values)


@settings(deadline=None, max_examples=40)
@given(impulse_responses, inputs)
def test_prediction_is_the_causal_filter_of_the_input(h, u):
    predicted = StepResponseModel.from_impulse_response(h, 5.0).predict(u)
    filtered = signal.lfilter(np.r_[0.0, h], [1.0], np.r_[u, 0.0])
    np.testing.assert_allclose(predicted, filtered, atol=1e-9)


@settings(deadline=None, max_examples=20)
@given(impulse_responses, inputs, inputs, values)
def test_prediction_is_linear_and_time_invariant(h, u, v, c):
    model = StepResponseModel.from_impulse_response(h, 5.0)
    np.testing.assert_allclose(model.predict(u + c * v), model.predict(u) + c * model.predict(v), atol=1e-7)
    late = model.predict(np.r_[np.zeros(3), u])
    np.testing.assert_allclose(late[3:], model.predict(u), atol=1e-9)
    np.testing.assert_array_equal(late[:4], 0.0)


def test_unit_step_returns_the_step_response_and_then_its_last_value():
    model = StepResponseModel(step_response=jnp.array([-0.1, -0.5, -0.7, -0.8]), sample_time_min=5.0)
    np.testing.assert_allclose(model.predict(np.ones(7)), [0, -0.1, -0.5, -0.7, -0.8, -0.8, -0.8, -0.8])
    assert model.memory == 4
    assert model.gain == -0.8
    np.testing.assert_allclose(model.impulse_response, [-0.1, -0.4, -0.2, -0.1])


def test_step_response_of_a_sampled_linear_system_is_that_of_python_control():
    plant = control.sample_system(control.tf([-3.0], [800.0, 60.0, 1.0]), 5.0, "zoh")
    _, step = control.step_response(plant, 5.0 * np.arange(61))
    _, impulse = control.impulse_response(plant, 5.0 * np.arange(61))
    model = StepResponseModel.from_impulse_response(impulse[1:] * 5.0, 5.0)  # control scales a pulse to unit area
    np.testing.assert_allclose(model.step_response, step[1:], atol=1e-10)


@settings(deadline=None, max_examples=20)
@given(impulse_responses, inputs, st.integers(0, 3))
def test_delay_shifts_the_prediction_and_keeps_the_gain(h, u, samples):
    model = StepResponseModel.from_impulse_response(h, 5.0)
    delayed = model.delayed(samples)
    shifted = np.r_[np.zeros(samples), model.predict(u)][: len(u) + 1]
    np.testing.assert_allclose(delayed.predict(u), shifted, atol=1e-9)
    assert delayed.memory == model.memory + samples
    assert delayed.gain == model.gain


def test_delays_add_up():
    model = StepResponseModel.from_impulse_response([-0.1, -0.4], 5.0)
    np.testing.assert_array_equal(model.delayed(1).delayed(2).step_response, model.delayed(3).step_response)


def test_lagged_inputs_are_the_toeplitz_matrix_of_the_past():
    np.testing.assert_array_equal(lagged_inputs([1.0, 2.0, 3.0], 2), [[0, 0], [1, 0], [2, 1], [3, 2]])


def test_columns_of_models_and_vmapped_inputs_agree_with_one_at_a_time():
    rng = np.random.default_rng(1)
    h, u = rng.normal(size=(6, 3)), rng.normal(size=(4, 20))
    many = StepResponseModel.from_impulse_response(h, 5.0)
    together = jax.vmap(many.predict)(u)
    for r in range(3):
        for k in range(4):
            one = StepResponseModel.from_impulse_response(h[:, r], 5.0).predict(u[k])
            np.testing.assert_allclose(together[k, :, r], one, atol=1e-12)


@pytest.mark.parametrize("samples", [-1, 1.5, True, "2"])
def test_a_delay_that_is_no_number_of_samples_is_refused(samples):
    model = StepResponseModel.from_impulse_response([-0.1], 5.0)
    with pytest.raises(ValueError, match=r"delay of .* is not a whole number of at least 0"):
        model.delayed(samples)


@pytest.mark.parametrize("sample_time", [0.0, -5.0, np.nan, np.inf])
def test_a_sample_time_out_of_bounds_is_refused(sample_time):
    with pytest.raises(ValueError, match="sample time"):
        StepResponseModel.from_impulse_response([-0.1], sample_time)


def test_an_impulse_response_that_is_empty_or_not_finite_is_refused():
    with pytest.raises(ValueError, match="no coefficient"):
        StepResponseModel.from_impulse_response([], 5.0)
    with pytest.raises(ValueError, match="1 of 3 impulse-response coefficients are not finite"):
        StepResponseModel.from_impulse_response([-0.1, np.nan, 0.2], 5.0)


def test_an_input_with_two_axes_is_refused():
    with pytest.raises(ValueError, match=r"not one-dimensional.*vmap"):
        StepResponseModel.from_impulse_response([-0.1], 5.0).predict(np.zeros((3, 2)))


def geometric(first, pole, after):
    """Realisation of increments that fall by the same ratio after so many samples."""
    return Realisation(transition=np.array([[pole]]), start=np.array([first]), output=np.ones(1), after=after)


@settings(deadline=None, max_examples=20)
@given(impulse_responses, inputs, st.floats(0.0, 0.95))
def test_a_realisation_goes_on_after_the_memory(h, u, pole):
    model = StepResponseModel.from_impulse_response(h, 5.0, realisation=geometric(h[-1] * pole, pole, len(h)))
    whole = np.r_[h, h[-1] * pole ** np.arange(1, 400)]
    np.testing.assert_allclose(model.predict(u), signal.lfilter(np.r_[0.0, whole], [1.0], np.r_[u, 0.0]), atol=1e-9)
    np.testing.assert_allclose(model.gain, whole.sum(), atol=1e-5)
    np.testing.assert_allclose(model.delayed(3).gain, model.gain)
    for response in (model.step_response, np.asarray(model.step_response)):
        longer = extended(response, model.realisation, 60)
        np.testing.assert_allclose(longer, np.cumsum(whole)[:60], atol=1e-9)


@settings(deadline=None, max_examples=20)
@given(st.integers(1, 4), st.integers(0, 10_000), st.integers(0, 9))
def test_a_realisation_is_a_discrete_time_system(order, seed, after):
    rng = np.random.default_rng(seed)
    A = rng.uniform(-1.0, 1.0, (order, order))
    A *= 0.95 / max(1.0, np.abs(np.linalg.eigvals(A)).max())
    b, c = rng.uniform(-1.0, 1.0, (2, order))
    _, (y,) = signal.dimpulse((A, b[:, None], c[None], np.zeros((1, 1)), 1.0), n=600)
    early, generated = rng.uniform(-1.0, 1.0, after), y[1:, 0]
    realisation = Realisation(transition=A, start=b, output=c, after=after)
    model = StepResponseModel.from_impulse_response(np.r_[early, generated[:5]], 5.0, realisation=realisation)
    np.testing.assert_allclose(
        extended(model.step_response, realisation, 100), np.cumsum(np.r_[early, generated])[:100], atol=1e-9
    )
    np.testing.assert_allclose(model.gain, early.sum() + generated.sum(), atol=1e-6)


@pytest.mark.parametrize(
    ("realisation", "sentence"),
    [
        (geometric(-0.25, 1.0, 2), "eigenvalue of magnitude 1 does not decay: give one .* less than 1"),
        (geometric(-0.25, np.nan, 2), "eigenvalue of magnitude inf does not decay"),
        (geometric(-0.25, 0.5, 3), "after 3 samples .* the memory of 2: give one that begins there or before"),
        (geometric(-0.4, 0.5, 1), "differs from the impulse response by 0.1 mg/dl per mU/min within its memory"),
        (geometric(np.nan, 0.5, 1), "differs from the impulse response by nan"),
    ],
)
def test_a_realisation_of_another_response_is_refused(realisation, sentence):
    with pytest.raises(ValueError, match=sentence):
        StepResponseModel.from_impulse_response([-1.0, -0.5], 5.0, realisation=realisation)
