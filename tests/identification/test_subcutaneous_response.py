"""Response to insulin under the skin: beside the patients' own linearisation, and another solver."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

import glucoloop as gl
from glucoloop.identification import filtered_input, identify_record, subcutaneous_coefficients
from glucoloop.identification.laguerre import laguerre_functions
from glucoloop.identification.subcutaneous_response import subcutaneous_basis
from glucoloop.models.state_space import step_response
from glucoloop.models.step_response import StepResponseModel

SLOW = ("hovorka-2004", "wilinska-2010")


def falling(pole, samples):
    """Impulse response that begins at 0 with a slope of 0, in the span of three Laguerre functions of its pole."""
    i = np.arange(samples)
    return -0.01 * i * (i - 1) * pole**i


def truth_of(person, samples, sample_time_min=5.0):
    return np.asarray(step_response(gl.linear_model(person, sample_time_min=sample_time_min), samples))


@pytest.mark.long
@pytest.mark.parametrize("name", SLOW)
@pytest.mark.parametrize("noise", [0.0, 1.45])
def test_the_step_response_is_that_of_the_linearised_patient(name, noise):
    person = gl.patient(name)
    for seed in range(3 if noise else 1):
        S = np.asarray(gl.identify(person, gl.white_noise(noise) if noise else None, seed).model.step_response)
        true = truth_of(person, S.size)
        assert np.all(S <= 1e-9)  # never a rise, from the first sample
        assert np.all(np.diff(S) <= 1e-9)
        early = slice(0, 48)  # four hours
        error = np.sqrt(np.mean((S - true)[early] ** 2)) / np.abs(true[early]).max()
        assert error < (0.25 if noise else 0.03)


@pytest.mark.long
def test_what_the_functions_span_comes_back_from_a_whole_record():
    """A response that has not died out between two pulses, which cross-correlation would bend."""
    pole, functions, memory = 0.97, 6, 60
    endless = StepResponseModel.from_impulse_response(falling(pole, 900), 5.0)
    coefficients = np.linalg.lstsq(np.asarray(laguerre_functions(pole, functions, 900)).T, falling(pole, 900))[0]
    insulin = np.zeros(2 * memory)
    insulin[0], insulin[memory] = 20.0, -20.0
    glucose = 120.0 + np.asarray(endless.predict(insulin))
    columns = filtered_input(insulin, pole, functions)
    np.testing.assert_allclose(columns @ coefficients, glucose - 120.0, atol=1e-7)
    record = gl.record_from_samples(
        5.0 * np.arange(insulin.size + 1), np.append(25.0 + insulin, 25.0), glucose, sample_time_min=5.0
    )[0]
    found = identify_record(record, memory=memory, laguerre_pole=pole, laguerre_functions=functions, subcutaneous=True)
    np.testing.assert_allclose(found.laguerre_coefficients, coefficients, atol=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_the_fit_is_the_best_one_that_never_rises(seed):
    pole, functions, memory = 0.9, 6, 40
    rng = np.random.default_rng(seed)
    rows = np.asarray(laguerre_functions(pole, functions, memory))
    columns = rng.normal(size=(80, functions))
    truth = np.linalg.lstsq(rows.T, falling(pole, memory))[0]
    readings = columns @ truth + rng.normal(size=80)
    found = subcutaneous_coefficients(columns, readings, pole, functions, memory)
    combinations = subcutaneous_basis(pole, functions, memory)
    other = minimize(
        lambda c: np.sum((columns @ combinations @ c - readings) ** 2),
        np.zeros(combinations.shape[1]),
        jac=lambda c: 2 * combinations.T @ columns.T @ (columns @ combinations @ c - readings),
        constraints={"type": "ineq", "fun": lambda c: -(rows.T @ combinations @ c)[2:]},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert np.max(rows.T @ found) < 1e-9
    np.testing.assert_allclose(rows[:, :2].T @ found, 0.0, atol=1e-12)
    np.testing.assert_allclose(found, combinations @ other.x, atol=1e-5)
    several = subcutaneous_coefficients(columns, np.stack([readings, 2 * readings], axis=1), pole, functions, memory)
    np.testing.assert_allclose(several, np.stack([found, 2 * found], axis=1), atol=1e-9)


def test_a_record_in_which_insulin_raises_glucose_is_not_bent_to_the_contrary():
    pole, functions = 0.9, 6
    columns = filtered_input(np.random.default_rng(0).normal(size=100), pole, functions)
    raised = columns @ subcutaneous_basis(pole, functions, 100) @ np.array([1.0, 0.3, 0.2, 0.1])
    found = subcutaneous_coefficients(columns, raised, pole, functions, 60)
    np.testing.assert_allclose(columns @ found, raised, atol=1e-8)
    assert float(jnp.sum(found)) > 0.0
