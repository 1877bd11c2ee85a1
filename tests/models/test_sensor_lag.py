"""A lag of the sensor in the models of controllers: closed forms, the transfer function, and undershoot in a loop."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.build.designs import controller_of
from glucoloop.control import MPCSE, Observation, StateTuning, design_mpc_se
from glucoloop.models.nonlinear import individual_model
from glucoloop.models.sensor_lag import behind_lag, linear_behind_lag
from glucoloop.models.state_space import ContinuousModel, discretise, linearise, step_response
from glucoloop.sensors.delay import lagged
from glucoloop.simulation import linear_model, nonlinear_model
from glucoloop.situations.situation import configured
from glucoloop.trials.trial import Trial

LAG, GAIN, TAU = 10.0, -3.0, 50.0
REST = 81.0
FIRST_ORDER = ContinuousModel(
    A=jnp.array([[-1.0 / TAU]]),
    B=jnp.array([GAIN / TAU]),
    C=jnp.ones(1),
    state=jnp.zeros(1),
    insulin_mU_min=jnp.asarray(25.0),
    glucose_mg_dl=jnp.asarray(REST),
)
BEHIND = linear_behind_lag(FIRST_ORDER, LAG)
glucoses = st.floats(20.0, 500.0)


def test_the_step_response_of_readings_is_that_of_two_lags():
    model = discretise(BEHIND, 5.0)
    t = 5.0 * np.arange(1, 41)
    glucose = GAIN * (1.0 - np.exp(-t / TAU))
    reading = GAIN * (1.0 - (TAU * np.exp(-t / TAU) - LAG * np.exp(-t / LAG)) / (TAU - LAG))
    np.testing.assert_allclose(step_response(model, 40), glucose, rtol=1e-12)
    seen = dataclasses.replace(model, C=model.reading_row)
    np.testing.assert_allclose(step_response(seen, 40), reading, rtol=1e-12)
    np.testing.assert_array_equal(model.state, [0.0, REST])


def test_the_reading_has_the_transfer_function_of_glucose_times_that_of_the_lag():
    rng = np.random.default_rng(5)
    A = rng.normal(size=(4, 4)) / 20.0 - 0.2 * np.eye(4)
    B, E, C = rng.normal(size=(3, 4))
    person = dataclasses.replace(
        FIRST_ORDER, A=jnp.asarray(A), B=jnp.asarray(B), C=jnp.asarray(C), E=jnp.asarray(E), state=jnp.zeros(4)
    )
    behind = linear_behind_lag(person, LAG)

    def response(A, into, out, s):
        return np.asarray(out) @ np.linalg.solve(s * np.eye(len(A)) - np.asarray(A), np.asarray(into))

    for s in 1j * np.geomspace(1e-4, 10.0, 9):
        for plain, late in ((B, behind.B), (E, behind.E)):
            glucose = response(A, plain, C, s)
            np.testing.assert_allclose(response(behind.A, late, behind.C, s), glucose, rtol=1e-10)
            np.testing.assert_allclose(
                response(behind.A, late, behind.C_reading, s), glucose / (LAG * s + 1.0), rtol=1e-10
            )


@pytest.mark.long
def test_both_models_of_a_patient_have_the_same_linearisation(patient_81):
    linear = linear_model(patient_81, sensor_lag_min=LAG)
    model = behind_lag(nonlinear_model(patient_81), LAG)

    @jax.jit
    def at_rest(x, u):
        return discretise(linearise(model.derivative, model.glucose_mg_dl, x, u, reading=model.reading_mg_dl), 5.0)

    sampled = at_rest(model.state, model.insulin_mU_min)
    for name in ("Phi", "Gamma", "C", "C_reading", "state"):
        np.testing.assert_allclose(getattr(sampled, name), getattr(linear, name), atol=1e-12, err_msg=name)
    without = linear_model(patient_81)
    np.testing.assert_array_equal(without.reading_row, without.C)
    np.testing.assert_allclose(step_response(linear, 36), step_response(without, 36), rtol=1e-10)


@pytest.mark.long
def test_the_nonlinear_reading_follows_the_differential_equation(patient_81):
    """It is off by no more than glucose is off a line within a sample, under the largest moves of a pump."""
    model = behind_lag(nonlinear_model(patient_81), LAG)
    rates = float(model.insulin_mU_min) + np.repeat([16.7, -16.7, 0.0], 6)
    advance, slope = jax.jit(model.advance), jax.jit(model.derivative)
    x = truth = np.asarray(model.state)
    off_line = apart = 0.0
    t = np.linspace(0.0, 5.0, 21)
    for rate in rates:
        x = np.asarray(advance(x, rate))
        solved = scipy.integrate.solve_ivp(
            lambda _, y, rate=rate: np.asarray(slope(y, rate)), (0.0, 5.0), truth, "LSODA", t, rtol=1e-9, atol=1e-9
        )
        truth, glucose = solved.y[:, -1], solved.y[2]
        off_line = max(off_line, np.abs(glucose - np.interp(t, [0.0, 5.0], glucose[[0, -1]])).max())
        apart = max(apart, abs(truth[2] - truth[-1]))
        assert abs(x[2] - truth[2]) < 0.01
        assert abs(x[-1] - truth[-1]) < off_line
    assert apart > 3.0


def test_readings_behind_glucose_that_rises_evenly_are_behind_by_the_lag():
    t = 5.0 * np.arange(40)
    behind = [REST]
    for before, now in zip(REST + 2.0 * t[:-1], REST + 2.0 * t[1:], strict=True):
        behind.append(float(lagged(jnp.asarray(behind[-1]), before, now, LAG, 5.0)))
    np.testing.assert_allclose(behind, REST + 2.0 * (t - LAG * (1.0 - np.exp(-t / LAG))), rtol=1e-12)


@given(glucoses, glucoses, glucoses, st.floats(0.01, 120.0), st.floats(0.5, 60.0))
def test_a_reading_behind_a_lag_is_between_what_was_there_and_half_samples_make_a_whole(r, before, now, lag, sample):
    whole = float(lagged(r, before, now, lag, sample))
    assert min(r, before, now) - 1e-9 <= whole <= max(r, before, now) + 1e-9
    middle = (before + now) / 2.0
    half = lagged(r, before, middle, lag, sample / 2.0)
    assert float(lagged(half, middle, now, lag, sample / 2.0)) == pytest.approx(whole, rel=1e-9)


def test_a_person_of_ones_own_keeps_the_lag(patient_81):
    model = behind_lag(nonlinear_model(patient_81), LAG)
    own = individual_model(model, model.insulin_mU_min, 1.2, 0.8)
    x = own.state.at[-2].set(70.0)
    assert float(own.reading_mg_dl(x)) == 70.0
    assert float(own.glucose_mg_dl(x)) == pytest.approx(81.1, abs=0.1)
    assert own.state.shape == (21,)


@pytest.mark.parametrize("lag", [0.0, -5.0, np.nan, np.inf])
def test_what_is_no_lag_is_refused(lag):
    with pytest.raises(ValueError, match=r"a lag of the sensor of .* min is not possible; give a finite time above 0"):
        linear_behind_lag(FIRST_ORDER, lag)
    with pytest.raises(ValueError, match="give a finite time above 0"):
        behind_lag(nonlinear_model, lag)


# --------------------------------------------------------------------------------------------- controllers


@pytest.mark.long
@pytest.mark.parametrize("name", ["mpc-se", "nlqdmc-se", "meal-mpc"])
def test_a_controller_is_told_of_a_lag_by_a_setting(name):
    sizes = []
    for lag in (0.0, LAG):
        trial = configured(Trial, controller={"name": name, "sensor_lag_min": lag}, sensor="white-noise")
        controller = controller_of(trial, trial.cases[0])
        state = controller.init(observe(REST, 25.0))
        held = state.estimator.hypotheses.x if name == "meal-mpc" else state.estimate
        sizes.append(held.shape[0])
    assert sizes[1] == sizes[0] + 1


def test_a_lag_beyond_two_hours_is_refused():
    with pytest.raises(ValueError, match="sensor_lag_min is 150 min; give a number from 0 to 120"):
        MPCSE(sensor_lag_min=150.0)


def observe(reading, rate):
    return Observation(
        glucose_mg_dl=jnp.asarray(reading, float),
        valid=jnp.asarray(True),
        setpoint_mg_dl=jnp.asarray(REST),
        delivered_mU_min=jnp.asarray(rate, float),
        announced_carbs_g=jnp.zeros(()),
    )


@pytest.mark.long
def test_told_of_the_lag_a_controller_undershoots_nearly_as_little_as_without_one():
    plant = discretise(dataclasses.replace(FIRST_ORDER, E=jnp.ones(1)), 5.0)
    Phi, Gamma, Psi = float(plant.Phi[0, 0]), float(plant.Gamma[0]), float(plant.Psi[0])
    step = jax.jit(lambda controller, state, seen: controller.step(state, seen))
    tuning = StateTuning(move_horizon=2, prediction_horizon=8, output_weight=1.0, move_weight=0.3)

    def undershoot(model, noise, lag):
        controller = design_mpc_se(model, noise, tuning)
        state, rate, glucose, behind, lowest = controller.init(observe(REST, 25.0)), 25.0, REST, REST, REST
        for k in range(60):
            state, decision = step(controller, state, observe(behind if lag else glucose, rate))
            rate = float(decision.insulin_mU_min)
            before = glucose
            meal = 2.0 if k < 9 else 0.0
            glucose = REST + Phi * (before - REST) + Gamma * (rate - 25.0) + Psi * meal
            behind = float(lagged(behind, before, glucose, LAG, 5.0))
            lowest = min(lowest, glucose)
        assert glucose == pytest.approx(REST, abs=0.2)
        return REST - lowest

    plain, told = discretise(FIRST_ORDER, 5.0), discretise(BEHIND, 5.0)
    without = undershoot(plain, [3.0], lag=False)
    untold, knowing = undershoot(plain, [3.0], lag=True), undershoot(told, [3.0, 0.0], lag=True)
    assert abs(knowing - without) < 0.5 * (untold - without)
