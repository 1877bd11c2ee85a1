"""Nonlinear control: one sample against an independent implementation, the paper's numbers, and what it is for."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from glucoloop.control import StateTuning, Status, design_mpc_se, design_nlqdmc_se
from glucoloop.control.tuning import PARKER_1999
from glucoloop.estimation.noise_level import LEVELS_MG_DL, SensorError, noisy_filters
from glucoloop.patients import patient
from glucoloop.patients.capabilities import process_noise
from glucoloop.simulation import linear_model, nonlinear_model, simulate
from observing import observing

TUNING = PARKER_1999["setpoint-81", True]
BASAL = 25.606057344

step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
observe = observing(setpoint=81.1, delivered=BASAL)


@pytest.fixture(scope="module")
def imagined(patient_81):
    return nonlinear_model(patient_81)


@pytest.fixture(scope="module")
def controller(imagined):
    return design_nlqdmc_se(imagined, process_noise(patient(), *TUNING.noise), TUNING.nlqdmc_se)


@pytest.fixture(scope="module")
def advance(imagined):
    return jax.jit(imagined.advance)


# ------------------------------------------------------------------------------------------- the paper


@pytest.mark.long
@pytest.mark.parametrize(("point", "undershoot", "settling"), [("setpoint-81", 3.6, 211), ("nominal-22", 3.6, 209)])
def test_table_i(point, undershoot, settling, patient_81, patient_22, undershoot_and_settling):
    person = patient_81 if point == "setpoint-81" else patient_22
    tuning = PARKER_1999[point, False]
    controller = design_nlqdmc_se(nonlinear_model(person), process_noise(person, *tuning.noise), tuning.nlqdmc_se)
    trace = simulate(person, controller)
    found = undershoot_and_settling(trace.fine_glucose_mg_dl, person.setpoint_mg_dl, 0.02)
    assert found[0] == pytest.approx(undershoot, abs=0.3)
    assert found[1] == pytest.approx(settling, abs=12)


@pytest.mark.long
def test_told_of_another_basal_rate_it_doses_as_much_above_that(controller):
    doses = []
    for one, basal in ((controller, BASAL), (controller.with_basal(jnp.asarray(BASAL + 6.0)), BASAL + 6.0)):
        state, rate = one.init(observe(81.1, basal)), basal
        for reading in (84.0, 90.0):
            state, decision = step(one, state, observe(reading, rate))
            rate = float(decision.insulin_mU_min)
            doses.append(rate - basal)
    np.testing.assert_allclose(doses[:2], doses[2:], rtol=1e-6, atol=1e-6)
    assert abs(doses[1]) > 0.1


# ------------------------------------------------------------------------------------------- one sample


def finite_differences(f, x, h):
    return np.stack([(f(x + h * e) - f(x - h * e)) / (2.0 * h) for e in np.eye(x.size)], axis=1)


def integrate(sorensen, x, delivered):
    rates = scipy.integrate.solve_ivp(
        lambda _, x: sorensen(x, delivered, 0.0), (0.0, 5.0), x, method="LSODA", rtol=1e-10, atol=1e-10
    )
    return rates.y[:, -1]


def by_hand(sorensen, advance, P, x, delivered, reading, tuning, Q):
    """First move and estimate of one sample, with SciPy's matrix exponential and least squares."""
    prior = advance(x)
    A = finite_differences(lambda x: sorensen(x, delivered, 0.0), prior, 1e-4)
    B = (sorensen(prior, delivered + 1e-3, 0.0) - sorensen(prior, delivered - 1e-3, 0.0)) / 2e-3
    held = scipy.linalg.expm(5.0 * np.block([[A, B[:, None]], [np.zeros((1, 20))]]))
    Phi, Gamma, C = held[:19, :19], held[:19, 19], np.eye(19)[2]
    for _ in range(4):  # from the steady covariance of the sample before
        seen = P @ C
        P = Phi @ (P - np.outer(seen, seen) / (C @ seen + 1.45)) @ Phi.T + np.diag(Q)
    correction = P @ C / (C @ P @ C + 1.45) * (reading - prior[2])
    z = prior + correction

    p, m = tuning.prediction_horizon, tuning.move_horizon
    w, free = z, []
    for _ in range(p):
        w = advance(w) + correction
        free.append(w[2])
    reference = 81.1 + tuning.reference_filter ** (np.arange(1, p + 1) - tuning.reference_start) * (z[2] - 81.1)
    S = np.cumsum([C @ np.linalg.matrix_power(Phi, i) @ Gamma for i in range(p)])
    stacked = np.r_[
        tuning.output_weight * scipy.linalg.toeplitz(S, [S[0], *[0.0] * (m - 1)]), tuning.move_weight * np.eye(m)
    ]
    wanted = np.r_[tuning.output_weight * (reference - free), np.zeros(m)]
    return np.linalg.lstsq(stacked, wanted, rcond=None)[0][0], z


def steady_by_scipy(model, Q):
    Phi, C = np.asarray(model.Phi), np.asarray(model.C)
    return scipy.linalg.solve_discrete_are(Phi.T, C[:, None], np.diag(Q), np.array([[1.45]]))


@pytest.mark.long
@pytest.mark.parametrize(("rest", "delivered", "surprise"), [(81.1, 27.0, 2.0), (120.0, 20.0, -3.0), (62.0, 24.0, 1.5)])
def test_one_sample_is_that_of_an_independent_implementation(
    patient_81, sorensen_by_hand, controller, advance, rest, delivered, surprise
):
    """Away from the operating point, where neither the gain nor the step response is the one of the design."""
    x = np.asarray(patient_81.steady_state(patient_81.insulin_for(rest))) * (1.0 + 0.003 * np.cos(np.arange(19)))
    reading = float(advance(x, delivered)[2]) + surprise
    state = dataclasses.replace(controller.init(observe(81.1)), estimate=jnp.asarray(x))
    state, decision = step(controller, state, observe(reading, delivered))
    found = float(decision.insulin_mU_min) - delivered
    assert abs(found) > 0.5

    Q = process_noise(patient(), *TUNING.noise)
    settings = (steady_by_scipy(linear_model(patient_81), Q), x, delivered, reading, TUNING.nlqdmc_se, Q)
    move, z = by_hand(sorensen_by_hand, lambda x: np.asarray(advance(x, delivered)), *settings)
    np.testing.assert_allclose(state.estimate, z, rtol=1e-6, atol=1e-7)
    assert found == pytest.approx(move, rel=1e-6)
    # and with another integrator, to the accuracy of one step a sample
    move, z = by_hand(sorensen_by_hand, lambda x: integrate(sorensen_by_hand, x, delivered), *settings)
    np.testing.assert_allclose(state.estimate, z, atol=5e-3)
    assert found == pytest.approx(move, rel=3e-3)


# ------------------------------------------------------------------------------------------- relinearisation


@pytest.fixture(scope="module")
def linear_twin(patient_81):
    """MPC/SE with everything else the same."""
    return design_mpc_se(
        linear_model(patient_81), process_noise(patient(), *TUNING.noise), TUNING.nlqdmc_se, constraints="qp"
    )


def doses_of(controller, deviations):
    state, delivered, doses = controller.init(observe(81.1)), BASAL, []
    for deviation in deviations:
        state, decision = step(controller, state, observe(81.1 + deviation, delivered))
        delivered = float(decision.insulin_mU_min)
        doses.append(delivered - BASAL)
    return np.array(doses)


@pytest.mark.long
def test_near_the_operating_point_it_is_linear_control_and_away_from_it_it_is_not(controller, linear_twin):
    shape = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 2.0, 0.0, -1.0])
    apart = {}
    for size in (1e-3, 1e-2, -2.0):
        nonlinear, linear = doses_of(controller, size * shape), doses_of(linear_twin, size * shape)
        apart[size] = np.abs(nonlinear - linear).max() / np.abs(linear).max()
    assert apart[1e-3] < 1e-4
    assert apart[1e-2] == pytest.approx(10.0 * apart[1e-3], rel=0.1)  # what curvature gives
    assert apart[-2.0] > 0.1


@pytest.mark.long
def test_near_the_operating_point_the_filter_for_correlated_noise_is_that_of_the_linear_model(imagined, patient_81):
    Q = process_noise(patient(), *TUNING.noise)
    controller = design_nlqdmc_se(imagined, Q, TUNING.nlqdmc_se, noise_pace=0.2)
    linear = linear_model(patient_81)
    filters = noisy_filters(linear.Phi, linear.C, np.diag(Q), 1.45, pace=0.2)
    glucose = float(imagined.glucose_mg_dl(imagined.state))
    for deviation in (0.0, 3.0):
        state = controller.init(observe(81.1))
        sensor = SensorError(error_mg_dl=jnp.asarray(0.0), deviation_mg_dl=jnp.asarray(deviation))
        for _ in range(20):  # in which the covariance comes to rest at the size that it is told
            state, _ = step(controller, dataclasses.replace(state, sensor=sensor), observe(glucose))
        state = dataclasses.replace(state, estimate=imagined.state, sensor=sensor)
        state, _ = step(controller, state, observe(81.1 - 2.0))
        level = LEVELS_MG_DL.index(deviation)
        residual = 81.1 - 2.0 - glucose
        correction = np.append(state.estimate - imagined.state, state.sensor.error_mg_dl)
        np.testing.assert_allclose(correction, filters.gain[level] * residual, rtol=1e-3, atol=1e-4)
        z = residual / np.sqrt(float(filters.innovation_variance[level]))
        expected = np.clip(deviation + 0.2 * (z**2 - 1.0), 0.0, 6.0)
        assert float(state.sensor.deviation_mg_dl) == pytest.approx(expected, abs=1e-4)


# ------------------------------------------------------------------------------------------- bad readings


@pytest.mark.long
def test_a_reading_that_is_no_number_is_bridged(controller):
    state = controller.init(observe(81.1))
    for reading in (np.nan, np.inf, -np.inf):
        state, decision = step(controller, state, observe(reading))
        assert int(decision.status) == Status.READING_MISSING
        assert float(decision.insulin_mU_min) == pytest.approx(BASAL, abs=1e-6)
        np.testing.assert_allclose(state.estimate, controller.model.state, rtol=1e-9)
    state, decision = step(controller, state, observe(95.0))
    assert float(decision.insulin_mU_min) > BASAL + 1.0


@pytest.mark.long
@pytest.mark.parametrize("readings", [(1.7e308, -1.7e308), (1e300, 1e300), (-1e200,)])
def test_an_estimate_that_is_lost_starts_anew_at_the_operating_point(controller, readings):
    state, delivered = controller.init(observe(81.1)), BASAL
    for reading in readings:
        state, decision = step(controller, state, observe(reading, delivered))
        delivered = float(decision.insulin_mU_min)
        assert np.all(np.isfinite(state.estimate))
        assert 0.0 <= delivered <= 66.9
    for _ in range(20):
        state, decision = step(controller, state, observe(81.1, delivered))
        delivered = float(decision.insulin_mU_min)
        assert np.all(np.isfinite(state.estimate))
    assert int(decision.status) in (Status.OK, Status.SATURATED)


def test_statuses(controller):
    state = controller.init(observe(81.1))
    _, missing = step(controller, state, observe(81.1, valid=False))
    _, ordinary = step(controller, state, observe(82.0))
    _, nothing = step(controller, state, observe(82.0, setpoint=np.nan))
    assert int(missing.status) == Status.READING_MISSING
    assert int(ordinary.status) == Status.OK
    assert int(nothing.status) == Status.NOT_CONVERGED
    assert float(nothing.insulin_mU_min) == pytest.approx(BASAL)


# ------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"process_noise": np.ones(5)}, "must be a covariance of the 19 states; give 19 variances of 0 or more"),
        ({"process_noise": np.full(19, -1.0)}, "must be a covariance of the 19 states"),
        ({"process_noise": np.full(19, np.nan)}, "must be a covariance of the 19 states"),
        ({"process_noise": np.triu(np.ones((19, 19)))}, "must be a covariance of the 19 states"),
        ({"measurement_variance": 0.0}, r"measurement_variance is 0; give a finite number above 0"),
        ({"measurement_variance": -1.0}, "measurement_variance is -1"),
        ({"noise_pace": 1.5}, "noise_pace is 1.5; give a number from 0 to 1"),
        ({"measurement_variance": np.inf}, "measurement_variance is inf"),
        ({"measurement_variance": np.nan}, "measurement_variance is nan"),
        ({"dead_time_samples": -1}, "dead time of -1 samples is not possible; give a whole number of 0 or more"),
        ({"dead_time_samples": 0.5}, "dead_time_samples is 0.5, a float"),
        ({"dead_time_samples": True}, "dead_time_samples is True, a bool"),
        ({"dead_time_samples": 284}, "prediction_horizon is 289; give"),
    ],
)
def test_what_cannot_be_designed_is_refused(imagined, changed, sentence):
    arguments = {"process_noise": process_noise(patient(), *TUNING.noise), "tuning": StateTuning(2, 5), **changed}
    with pytest.raises(ValueError, match=sentence):
        design_nlqdmc_se(imagined, **arguments)
