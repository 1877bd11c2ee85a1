"""MPC with state estimation: the paper's numbers, its estimator, and what removes a lasting error."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from glucoloop._pytree import pytree
from glucoloop.control import StateTuning, Status, design_mpc_se
from glucoloop.control.tuning import PARKER_1999
from glucoloop.estimation import steady_state_gain
from glucoloop.estimation.noise_level import SensorError
from glucoloop.models.state_space import LinearModel
from glucoloop.patients import patient
from glucoloop.patients.capabilities import process_noise
from glucoloop.pumps import dose_limits
from glucoloop.sensors import Reading, WhiteNoise, white_noise
from glucoloop.simulation import linear_model, simulate
from observing import observing

SEEDS = 60
# Insulin in blood, its delayed effect, and glucose: gain -4 mg/dl per mU/min.
A = np.array([[-1 / 25, 0.0, 0.0], [1 / 40, -1 / 40, 0.0], [0.0, -0.08, -1 / 50]])
_HELD = scipy.linalg.expm(5.0 * np.block([[A, np.array([[1 / 25], [0.0], [0.0]])], [np.zeros((1, 4))]]))
PHI, GAMMA, C = _HELD[:3, :3], _HELD[:3, 3], np.array([0.0, 0.0, 1.0])
INSULIN, GLUCOSE = 30.0, 90.0
MODEL = LinearModel(
    Phi=jnp.asarray(PHI),
    Gamma=jnp.asarray(GAMMA),
    C=jnp.asarray(C),
    state=jnp.zeros(3),
    insulin_mU_min=jnp.asarray(INSULIN),
    glucose_mg_dl=jnp.asarray(GLUCOSE),
    sample_time_min=5.0,
)
GAIN = float(C @ np.linalg.solve(np.eye(3) - PHI, GAMMA))
TUNING = StateTuning(2, 8, 1.0, 0.3, 0.65, 1)
WIDE = dose_limits(max_change_mU_min=1e3, max_mU_min=1e3)

step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
observe = observing(setpoint=GLUCOSE)


def test_told_of_another_basal_rate_it_doses_as_much_above_that():
    controller = design_mpc_se(MODEL, np.ones(3), TUNING, WIDE)
    other = controller.with_basal(jnp.asarray(INSULIN + 12.0))
    readings = [GLUCOSE, 97.0, 110.0, 104.0]
    doses = []
    for one, basal in ((controller, INSULIN), (other, INSULIN + 12.0)):
        state, rate = one.init(observe(GLUCOSE, basal)), basal
        for reading in readings:
            state, decision = step(one, state, observe(reading, rate))
            rate = float(decision.insulin_mU_min)
            doses.append(rate - basal)
    np.testing.assert_allclose(doses[:4], doses[4:], rtol=1e-9, atol=1e-9)
    assert abs(doses[3]) > 0.1


# ------------------------------------------------------------------------------------------- the paper


@pytest.mark.parametrize(("point", "undershoot", "settling"), [("setpoint-81", 4.9, 203), ("nominal-22", 4.4, 197)])
def test_table_i(point, undershoot, settling, patient_81, patient_22, undershoot_and_settling):
    person = patient_81 if point == "setpoint-81" else patient_22
    tuning = PARKER_1999[point, False]
    trace = simulate(
        person, design_mpc_se(linear_model(person), process_noise(patient(), *tuning.noise), tuning.mpc_se)
    )
    found = undershoot_and_settling(trace.fine_glucose_mg_dl, person.setpoint_mg_dl, 0.02)
    assert found[0] == pytest.approx(undershoot, abs=0.3)
    assert found[1] == pytest.approx(settling, abs=12)


@pytree
class Late:
    """A noisy sensor whose dead time, up to three samples, is data, so that all of Table II is one computation."""

    samples: jax.Array
    inner: WhiteNoise

    def init(self, glucose_mg_dl, key):
        return self.inner.init(glucose_mg_dl, key), jnp.full(4, glucose_mg_dl)

    def read(self, state, glucose_mg_dl, key):
        inner, line = state
        inner, reading = self.inner.read(inner, glucose_mg_dl, key)
        line = jnp.append(reading.glucose_mg_dl, line[:-1])
        return (inner, line), Reading(glucose_mg_dl=line[self.samples], valid=reading.valid)


TABLE_II = {
    (0, False): 12.8,
    (1, False): 15.4,
    (1, True): 15.0,
    (2, False): 18.2,
    (2, True): 17.5,
    (3, False): 29.2,
    (3, True): 26.6,
}


@pytest.fixture(scope="module")
def medians(patient_81):
    """Median of the lowest glucose of 60 runs, by dead time and whether it is known."""
    model, tuning = linear_model(patient_81), PARKER_1999["setpoint-81", True]

    def padded(known):
        """Samples beyond the prediction horizon count for nothing: all horizons become one length."""
        controller = design_mpc_se(
            model, process_noise(patient(), *tuning.noise), tuning.mpc_se, dead_time_samples=known
        )
        longest = tuning.mpc_se.prediction_horizon + 3

        def pad(leaf):
            axes = [(0, longest - n if n == controller.reference.shape[0] else 0) for n in leaf.shape]
            return jnp.pad(leaf, axes)

        plan = dataclasses.replace(
            controller.plan, gain=pad(controller.plan.gain), gradient=pad(controller.plan.gradient)
        )
        long = {name: pad(getattr(controller, name)) for name in ("free_state", "free_input", "free_innovation")}
        # the dead time is in these numbers; by itself it is there for forecasts, which are not asked for
        return controller.replaced(plan=plan, reference=pad(controller.reference), dead_time_samples=0, **long)

    controllers = [padded(samples if known else 0) for samples, known in TABLE_II]
    together = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *controllers)
    keys = jax.random.split(jax.random.key(0), SEEDS)

    def lowest(controller, samples):
        sensor = Late(samples=samples, inner=white_noise())
        return jax.vmap(lambda key: simulate(patient_81, controller, sensor, key=key).fine_glucose_mg_dl.min())(keys)

    found = jax.vmap(lowest)(together, jnp.array([samples for samples, _ in TABLE_II]))
    return dict(zip(TABLE_II, np.median(found, axis=1), strict=True))


@pytest.mark.parametrize("case", TABLE_II)
@pytest.mark.long
def test_medians_in_noise_with_and_without_dead_time(medians, case):
    assert 81.1 - medians[case] == pytest.approx(TABLE_II[case], abs=1.0)


@pytest.mark.long
def test_the_lowest_glucose_of_fig_4(medians):
    assert medians[0, False] == pytest.approx(68.3, abs=0.7)  # the paper: 68.5


# ------------------------------------------------------------------------------------------- estimation


@pytest.mark.parametrize("Q", [np.array([1.0, 2.0, 0.5]), np.diag([1.0, 2.0, 0.5]) + 0.1])
def test_the_gain_is_that_of_the_steady_filter(Q):
    found = design_mpc_se(MODEL, Q, TUNING, measurement_variance=2.5).kalman_gain
    full = np.diag(Q) if Q.ndim == 1 else Q
    P = scipy.linalg.solve_discrete_are(PHI.T, C[:, None], full, np.array([[2.5]]))
    np.testing.assert_allclose(found, P @ C / (C @ P @ C + 2.5), rtol=1e-9)
    np.testing.assert_allclose(found, steady_state_gain(PHI, C, full, 2.5).gain, rtol=1e-12)


def test_the_gain_of_the_paper_is_the_one_of_the_linearised_patient(patient_81):
    model, tuning = linear_model(patient_81), PARKER_1999["setpoint-81", True]
    Q = np.diag([0.9] * 8 + [0.01] * 9 + [0.005] * 2)
    Phi, row = np.asarray(model.Phi), np.eye(19)[2]
    P = scipy.linalg.solve_discrete_are(Phi.T, row[:, None], Q, np.array([[1.45]]))
    found = design_mpc_se(model, process_noise(patient(), *tuning.noise), tuning.mpc_se).kalman_gain
    np.testing.assert_allclose(found, P[:, 2] / (P[2, 2] + 1.45), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("Q", [np.ones(3), 30.0 * np.ones(3)])
@pytest.mark.parametrize("kind", ["output-disturbance", "input-disturbance"])
def test_an_integrating_state_is_estimated_with_the_others(kind, Q):
    controller = design_mpc_se(MODEL, Q, TUNING, offset_free=kind, disturbance_variance=0.7)
    entry = np.zeros(3) if kind == "output-disturbance" else GAMMA
    Phi = np.block([[PHI, entry[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    row = np.append(C, 1.0 if kind == "output-disturbance" else 0.0)
    P = scipy.linalg.solve_discrete_are(Phi.T, row[:, None], np.diag([*Q, 0.7]), np.array([[1.45]]))
    np.testing.assert_allclose(controller.kalman_gain, P @ row / (row @ P @ row + 1.45), rtol=1e-8)
    assert float(controller.C @ controller.rest) == pytest.approx(GAIN)


# ------------------------------------------------------------------------------------------- lasting errors

WRONG_MU_MIN = 5.0


def after_long(kind, Q, samples=400, setpoint=GLUCOSE):
    """Glucose, the last innovation's trace in the estimate, and dose, where 5 mU/min more goes in than is told."""
    controller = design_mpc_se(MODEL, Q * np.ones(3), TUNING, WIDE, offset_free=kind)
    x, delivered = np.zeros(3), INSULIN
    state = controller.init(observe(GLUCOSE, delivered, setpoint))
    for _ in range(samples):
        x = PHI @ x + GAMMA * (delivered - INSULIN + WRONG_MU_MIN)
        state, decision = step(controller, state, observe(GLUCOSE + C @ x, delivered, setpoint))
        delivered = float(decision.insulin_mU_min)
    return GLUCOSE + C @ x, GLUCOSE + float(controller.C @ state.estimate), delivered


@pytest.mark.parametrize("setpoint", [GLUCOSE, 84.0])
@pytest.mark.parametrize(("kind", "Q"), [("output-disturbance", 0.1), ("input-disturbance", 1.0)])
def test_an_estimated_disturbance_leaves_no_offset(kind, Q, setpoint):
    glucose, estimated, dose = after_long(kind, Q, setpoint=setpoint)
    assert glucose == pytest.approx(setpoint, abs=1e-5)
    assert estimated == pytest.approx(setpoint, abs=1e-5)
    assert dose == pytest.approx(INSULIN - WRONG_MU_MIN + (setpoint - GLUCOSE) / GAIN, abs=1e-5)


def held_or_not(Q, held):
    """Offset at steady state from the equations alone: where the plant, the filter and a plan without a move agree."""
    Q = Q * np.eye(3)
    P = scipy.linalg.solve_discrete_are(PHI.T, C[:, None], Q, np.array([[1.45]]))
    K = P @ C / (C @ P @ C + 1.45)
    keep, m, p = np.eye(3) - np.outer(K, C), TUNING.move_horizon, TUNING.prediction_horizon
    powers = [np.linalg.matrix_power(PHI, i) for i in range(p + 1)]
    S = np.cumsum([C @ power @ GAMMA for power in powers[:p]])
    answers = scipy.linalg.toeplitz(S, np.r_[S[0], np.zeros(m - 1)])
    first = np.linalg.solve(answers.T @ answers + TUNING.move_weight**2 * np.eye(m), answers.T)[0]
    glide = TUNING.reference_filter ** (np.arange(1, p + 1) - TUNING.reference_start)

    def planned(u):
        y = GAIN * (u + WRONG_MU_MIN)
        z = np.linalg.solve(np.eye(3) - keep @ PHI, keep @ GAMMA * u + K * y)
        innovation = y - C @ (PHI @ z + GAMMA * u)
        free = np.array([C @ powers[i] @ z for i in range(1, p + 1)]) + S * u
        if held:
            free = free + np.cumsum([C @ power @ K for power in powers[:p]]) * innovation
        return first @ (glide * (C @ z) - free), y, innovation, C @ K

    at_0, at_1 = planned(0.0)[0], planned(1.0)[0]
    return planned(-at_0 / (at_1 - at_0))


@pytest.mark.parametrize("Q", [1.0, 30.0])
def test_without_a_remedy_an_offset_is_left(Q):
    glucose, _, _ = after_long("none", Q)
    assert abs(glucose - GLUCOSE) > 5.0
    assert glucose - GLUCOSE == pytest.approx(held_or_not(Q, held=False)[1], rel=1e-6)


@pytest.mark.parametrize("Q", [1.0, 30.0, 1e4])
def test_a_held_innovation_leaves_the_part_of_it_that_the_estimate_does_not_take(Q):
    """It brings the estimate to the setpoint; glucose is beside it by (1 - C K) e."""
    glucose, estimated, _ = after_long("held-innovation", Q)
    assert estimated == pytest.approx(GLUCOSE, abs=1e-6)
    _, y, innovation, CK = held_or_not(Q, held=True)
    assert glucose - GLUCOSE == pytest.approx(y, abs=1e-6)
    assert glucose - GLUCOSE == pytest.approx((1.0 - CK) * innovation, abs=1e-6)
    without = held_or_not(Q, held=False)[1]
    assert abs(y) < 0.07 * abs(without)
    if Q == 1e4:  # where readings are trusted nothing is left
        assert abs(y) < 1e-4


# ------------------------------------------------------------------------------------------- dead time, rest


def test_a_known_dead_time_adds_rows_of_zeros_and_leaves_the_filter_alone():
    plain = design_mpc_se(MODEL, np.ones(3), TUNING)
    told = design_mpc_se(MODEL, np.ones(3), TUNING, dead_time_samples=3)
    np.testing.assert_allclose(told.plan.gain, np.r_[np.zeros(3), plain.plan.gain], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(told.plan.hessian, plain.plan.hessian, rtol=1e-12)
    np.testing.assert_array_equal(told.kalman_gain, plain.kalman_gain)
    np.testing.assert_allclose(told.free_input[:8], plain.free_input, rtol=1e-12)
    np.testing.assert_allclose(told.reference, 0.65 ** np.arange(11), rtol=1e-12)


@pytest.mark.parametrize("kind", ["held-innovation", "output-disturbance", "input-disturbance", "none"])
def test_at_another_basal_rate_it_wakes_at_rest(kind):
    """Glucose there is what the model says, and if it is what is wanted nothing moves."""
    controller = design_mpc_se(MODEL, np.ones(3), TUNING, offset_free=kind)
    rest = GLUCOSE + GAIN * 4.0
    state = controller.init(observe(rest, INSULIN + 4.0, rest))
    for _ in range(6):
        state, decision = step(controller, state, observe(rest, INSULIN + 4.0, rest))
        assert float(decision.insulin_mU_min) == pytest.approx(INSULIN + 4.0, abs=1e-10)
        assert int(decision.status) == Status.OK


# ------------------------------------------------------------------------------------------- noise of unknown size


def _by_riccati(deviation):
    """Gain of the states and of the sensor's error, whose standard deviation is known."""
    wide, drive = scipy.linalg.block_diag(PHI, 0.7), np.diag([1.0, 1.0, 1.0, (1.0 - 0.7**2) * deviation**2])
    row = np.append(C, 1.0)
    P = scipy.linalg.solve_discrete_are(wide.T, row[:, None], drive, np.array([[1.45]]))
    return P @ row / (row @ P @ row + 1.45), float(row @ P @ row) + 1.45


def test_the_size_of_correlated_noise_is_learned_and_the_filter_follows_it():
    controller = design_mpc_se(MODEL, np.ones(3), TUNING, WIDE, noise_pace=0.2)
    state = controller.init(observe(GLUCOSE, INSULIN))
    estimate, sensor = np.array([0.5, -0.2, 3.0]), (1.5, 3.0)
    state = dataclasses.replace(
        state,
        estimate=jnp.asarray(estimate),
        sensor=SensorError(error_mg_dl=jnp.asarray(1.5), deviation_mg_dl=jnp.asarray(3.0)),
    )
    rate = 2.0
    predicted, error = PHI @ estimate + GAMMA * rate, 0.7 * sensor[0]
    gain, variance = _by_riccati(sensor[1])
    innovation = -3.0  # only those below the prediction count
    reading = GLUCOSE + C @ predicted + error + innovation
    found, decision = step(controller, state, observe(reading, INSULIN + rate))
    estimate = predicted + gain[:3] * innovation
    np.testing.assert_allclose(found.estimate, estimate, rtol=1e-9)
    assert float(found.sensor.error_mg_dl) == pytest.approx(error + gain[3] * innovation)
    learned = sensor[1] + 0.2 * (min(innovation**2 / variance, 9.0) - 1.0)
    assert float(found.sensor.deviation_mg_dl) == pytest.approx(learned)

    free, w = [], estimate
    for _ in range(TUNING.prediction_horizon):
        w = PHI @ w + GAMMA * rate + gain[:3] * innovation
        free.append(C @ w)
    wanted = TUNING.reference_factors() * (C @ estimate) - np.array(free)
    S = np.cumsum([C @ np.linalg.matrix_power(PHI, i) @ GAMMA for i in range(TUNING.prediction_horizon)])
    A = scipy.linalg.toeplitz(S, [S[0], 0.0])
    move = np.linalg.solve(A.T @ A + TUNING.move_weight**2 * np.eye(2), A.T @ wanted)[0]
    assert float(decision.insulin_mU_min) == pytest.approx(INSULIN + rate + move, rel=1e-8)


@pytest.mark.parametrize("kind", ["held-innovation", "output-disturbance", "none"])
def test_before_any_noise_is_learned_it_is_the_filter_of_the_paper(kind):
    plain, learning = (
        design_mpc_se(MODEL, np.ones(3), TUNING, offset_free=kind, noise_pace=pace) for pace in (0.0, 0.2)
    )
    assert plain.init(observe(GLUCOSE, INSULIN)).sensor is None
    doses = [
        step(one, one.init(observe(GLUCOSE, INSULIN)), observe(GLUCOSE + 2.0, INSULIN))[1].insulin_mU_min
        for one in (plain, learning, learning.padded(2, 10))
    ]
    np.testing.assert_allclose(doses[1:], doses[0], rtol=1e-9)


# ------------------------------------------------------------------------------------------- bad readings


def test_a_missing_reading_is_bridged_by_the_model():
    """On a plant that is the model, losing readings changes nothing once the estimate is right."""
    controller = design_mpc_se(MODEL, np.ones(3), TUNING, WIDE)
    runs = []
    for lost in (set(), {2, 3, 4, 11}):
        x, delivered, doses = np.zeros(3), INSULIN, []
        state = controller.init(observe(GLUCOSE, INSULIN, 80.0))
        for k in range(20):
            reading = np.nan if k in lost else GLUCOSE + C @ x
            state, decision = step(controller, state, observe(reading, delivered, 80.0, valid=k not in lost))
            assert int(decision.status) == (Status.READING_MISSING if k in lost else Status.OK)
            delivered = float(decision.insulin_mU_min)
            x = PHI @ x + GAMMA * (delivered - INSULIN)
            doses.append(delivered)
        runs.append(doses)
    np.testing.assert_allclose(runs[1], runs[0], rtol=1e-10)


@pytest.mark.parametrize("noise_pace", [0.0, 0.5])
def test_an_estimate_that_overflows_starts_anew_at_rest(noise_pace):
    controller = design_mpc_se(MODEL, 30.0 * np.ones(3), TUNING, noise_pace=noise_pace)
    state = controller.init(observe(GLUCOSE, INSULIN))
    seen = []
    for reading in [1.7e308, -1.7e308] * 3:
        state, decision = step(controller, state, observe(reading, INSULIN))
        seen.append(Status(int(decision.status)))
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(state))
        assert 0.0 <= float(decision.insulin_mU_min) <= 66.9
    assert Status.NON_FINITE in seen
    np.testing.assert_allclose(state.estimate, 0.0)
    _, decision = step(controller, state, observe(GLUCOSE + 0.1, INSULIN))
    assert int(decision.status) == Status.OK


def test_statuses():
    controller = design_mpc_se(MODEL, np.ones(3), TUNING)
    state = controller.init(observe(GLUCOSE, INSULIN))
    exact = design_mpc_se(MODEL, np.ones(3), TUNING, constraints="qp")
    for expected, designed, seen in [
        (Status.OK, controller, observe(91.0, INSULIN)),
        (Status.SATURATED, controller, observe(300.0, INSULIN)),
        (Status.READING_MISSING, controller, observe(91.0, INSULIN, valid=False)),
        (Status.NON_FINITE, controller, observe(91.0, INSULIN, setpoint=np.nan)),
        (Status.NOT_CONVERGED, exact, observe(91.0, INSULIN, setpoint=np.nan)),
        (Status.OK, exact, observe(300.0, INSULIN)),  # the program keeps the limits itself
    ]:
        _, decision = step(designed, state, seen)
        assert Status(int(decision.status)) is expected
        assert abs(float(decision.insulin_mU_min) - INSULIN) <= 16.7 + 1e-12


# ------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"offset_free": "integral"}, "offset_free is 'integral'; give held-innovation, "),
        ({"constraints": "soft"}, "constraints is 'soft'; give clip or qp"),
        ({"dead_time_samples": -1}, "dead time of -1 samples is not possible; give a whole number of 0 or more"),
        ({"dead_time_samples": 1.5}, "dead_time_samples is 1.5, a float; give a whole number"),
        ({"dead_time_samples": True}, "dead_time_samples is True, a bool; give a whole number"),
        ({"dead_time_samples": 281}, "prediction_horizon is 289; give"),
        ({"process_noise": [1.0, 1.0]}, r"Q must be \(3, 3\) to go with Phi, but its shape is \(2, 2\)"),
        ({"process_noise": [1.0, -1.0, 1.0]}, "Q must be positive semi-definite, but its smallest eigenvalue is -1"),
        ({"process_noise": [1.0, np.nan, 1.0]}, "Q must be finite, but it holds nan"),
        ({"process_noise": np.triu(np.ones((3, 3)))}, "Q must be symmetric"),
        ({"measurement_variance": 0.0}, "measurement_variance is 0; give a finite number above 0"),
        ({"measurement_variance": np.inf}, "measurement_variance is inf; give"),
        ({"noise_pace": -0.1}, "noise_pace is -0.1; give a number from 0 to 1"),
        (
            {"offset_free": "input-disturbance", "disturbance_variance": 0.0},
            "every mode on the unit circle must be driven by Q",
        ),
        ({"offset_free": "input-disturbance", "disturbance_variance": -1.0}, "Q must be positive semi-definite"),
        ({"model": dataclasses.replace(MODEL, C=jnp.zeros(3))}, "mg/dl per mU/min is not possible"),
        ({"model": dataclasses.replace(MODEL, C=-MODEL.C)}, "mg/dl per mU/min is not possible; insulin lowers glucose"),
        (
            {"model": dataclasses.replace(MODEL, Phi=jnp.asarray(PHI) * 1.3, C=jnp.array([1.0, 0.0, 0.0]))},
            "every mode of Phi that is not stable must be seen by C",
        ),
    ],
)
def test_what_cannot_be_designed_is_refused(changed, sentence):
    arguments = {"model": MODEL, "process_noise": np.ones(3), "tuning": StateTuning(2, 8, 1.0, 0.0), **changed}
    with pytest.raises(ValueError, match=sentence):
        design_mpc_se(**arguments)
