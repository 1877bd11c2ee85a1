"""Predictive controllers are one another in the limits where they must be, and optimal where theory says so."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from glucoloop._pytree import pytree, static
from glucoloop.control import (
    MPCTuning,
    StateTuning,
    design_linear_mpc,
    design_mpc_se,
    design_nlqdmc_se,
)
from glucoloop.control.planning import dynamic_matrix
from glucoloop.models.state_space import LinearModel
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps import dose_limits
from observing import observing

# Insulin in blood, its delayed effect, and glucose: gain -4 mg/dl per mU/min.
A = np.array([[-1 / 25, 0.0, 0.0], [1 / 40, -1 / 40, 0.0], [0.0, -0.08, -1 / 50]])
B, C = np.array([1 / 25, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
_HELD = scipy.linalg.expm(5.0 * np.block([[A, B[:, None]], [np.zeros((1, 4))]]))
PHI, GAMMA = _HELD[:3, :3], _HELD[:3, 3]
INSULIN, GLUCOSE, R = 30.0, 90.0, 1.45
Q = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, 0.0], [0.1, 0.0, 0.5]])
WIDE = dose_limits(max_change_mU_min=1e6, max_mU_min=1e7)

step = jax.jit(lambda controller, state, observation: controller.step(state, observation))


def linear(insulin=INSULIN):
    return LinearModel(
        Phi=jnp.asarray(PHI),
        Gamma=jnp.asarray(GAMMA),
        C=jnp.asarray(C),
        state=jnp.zeros(3),
        insulin_mU_min=jnp.asarray(insulin),
        glucose_mg_dl=jnp.asarray(GLUCOSE),
        sample_time_min=5.0,
    )


@pytree
class LinearAsNonlinear:
    """The same plant as a controller of nonlinear models sees it."""

    state: jax.Array
    insulin_mU_min: jax.Array
    sample_time_min: float = static(default=5.0)

    def derivative(self, x, insulin_mU_min):
        return A @ (x - self.state) + B * (insulin_mU_min - self.insulin_mU_min)

    def advance(self, x, insulin_mU_min):
        return self.state + PHI @ (x - self.state) + GAMMA * (insulin_mU_min - self.insulin_mU_min)

    def glucose_mg_dl(self, x):
        return GLUCOSE + x[2] - self.state[2]


observe = observing(setpoint=GLUCOSE)


def kalman_gain():
    P = scipy.linalg.solve_discrete_are(PHI.T, C[:, None], Q, np.array([[R]]))
    return P @ C / (C @ P @ C + R)


def closed_loop(controller, samples, *, seed=0, insulin=INSULIN, setpoint=GLUCOSE, upset=20.0, noise=1.2):
    """Doses, readings and states in a loop with the plant, its glucose upset at the fifth sample."""
    rng = np.random.default_rng(seed)
    x, delivered, state, doses, readings = np.zeros(3), insulin, None, [], []
    for k in range(samples):
        x[2] += upset * (k == 5)
        y = GLUCOSE + C @ x + noise * rng.normal()
        seen = observe(y, delivered, setpoint)
        state = controller.init(seen) if state is None else state
        state, decision = step(controller, state, seen)
        delivered = float(decision.insulin_mU_min)
        x = PHI @ x + GAMMA * (delivered - insulin)
        doses.append(delivered)
        readings.append(y)
    return np.array(doses), np.array(readings)


# ------------------------------------------------------------------------------------------- without limits


@pytest.mark.long
def test_the_dynamic_matrix_is_the_toeplitz_matrix_of_the_step_response():
    S = np.array([-1.0, -3.0, -4.0, -4.5, -4.6])
    expected = scipy.linalg.toeplitz(S, [S[0], 0.0, 0.0])
    np.testing.assert_array_equal(dynamic_matrix(jnp.asarray(S), 3, 5), expected)
    # past its end the response stays where it is
    np.testing.assert_array_equal(dynamic_matrix(jnp.asarray(S), 1, 7)[:, 0], np.r_[S, S[-1], S[-1]])


def predicted(z, insulin, moves, correction, horizon):
    """Glucose deviation over the horizon by running the model, the correction being repeated at each sample."""
    w, u, out = z, insulin - INSULIN, []
    for i in range(horizon):
        u = u + (moves[i] if i < len(moves) else 0.0)
        w = PHI @ w + GAMMA * u + correction
        out.append(C @ w)
    return np.array(out)


@pytest.mark.long
@pytest.mark.parametrize(
    ("constraints", "tuning", "dead_time", "held"),
    [
        ("clip", StateTuning(2, 7, 1.0, 0.0, 0.65, 1), 0, True),
        ("qp", StateTuning(2, 7, 1.0, 0.0, 0.65, 1), 0, True),
        ("qp", StateTuning(2, 8, 3.0, 1.0, 0.65, 0), 0, False),
        ("clip", StateTuning(1, 12, 1.0, 0.5, 0.3, 1), 2, True),
        ("clip", StateTuning(4, 15, 2.0, 1.5, 0.0, 0), 1, True),
        ("qp", StateTuning(4, 15, 2.0, 1.5, 0.0, 0), 1, True),
    ],
)
def test_without_limits_the_first_move_is_the_least_squares_one(constraints, tuning, dead_time, held):
    controller = design_mpc_se(
        linear(),
        Q,
        tuning,
        WIDE,
        offset_free="held-innovation" if held else "none",
        dead_time_samples=dead_time,
        constraints=constraints,
    )
    base = 5e5  # far from the limits of any pump
    controller = controller.with_basal(jnp.asarray(base))
    rng, K = np.random.default_rng(3), kalman_gain()
    m, p = tuning.move_horizon, tuning.prediction_horizon
    late = p + dead_time
    for _ in range(10):
        z, u, reading, setpoint = rng.normal(0, 10, 3), 10 * rng.normal(), 90 + 20 * rng.normal(), 90 + 5 * rng.normal()
        state = dataclasses.replace(
            controller.init(observe(GLUCOSE, base)), estimate=jnp.asarray(z), insulin_mU_min=jnp.asarray(base)
        )
        _, decision = step(controller, state, observe(reading, base + u, setpoint))

        prior = PHI @ z + GAMMA * u
        innovation = reading - GLUCOSE - C @ prior
        z = prior + K * innovation
        free = predicted(z, INSULIN + u, [], K * innovation if held else 0.0, late)
        target = setpoint - GLUCOSE
        reference = target + tuning.reference_filter ** (np.arange(1, late + 1) - tuning.reference_start) * (
            C @ z - target
        )
        answers = np.stack([predicted(np.zeros(3), INSULIN, np.eye(m)[j], 0.0, late) for j in range(m)], axis=1)
        # a dead time that is known delays what the moves do, and only that
        answers = np.r_[np.zeros((dead_time, m)), answers[: late - dead_time]]
        stacked = np.r_[tuning.output_weight * answers, tuning.move_weight * np.eye(m)]
        wanted = np.r_[tuning.output_weight * (reference - free), np.zeros(m)]
        moves = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
        assert float(decision.insulin_mU_min) - base - u == pytest.approx(moves[0], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("moves", [1, 3])
def test_without_limits_the_exact_program_is_the_closed_form(moves):
    """Linear MPC with any number of moves: one in closed form, many by the interior point method."""
    steps = np.array([C @ np.linalg.matrix_power(PHI, i) @ GAMMA for i in range(40)])
    model = StepResponseModel.from_impulse_response(steps, 5.0)
    limits = dose_limits(max_change_mU_min=500.0, max_mU_min=1000.0)
    readings = 90.0 + 20.0 * np.random.default_rng(5).normal(size=15)
    runs = []
    for constraints in ("clip", "qp"):
        controller = design_linear_mpc(model, MPCTuning(moves, 12, 1.0, 3.0), limits, constraints=constraints)
        delivered, doses, state = 500.0, [], controller.init(observe(90.0, 500.0))
        for reading in readings:
            state, decision = step(controller, state, observe(reading, delivered))
            delivered = float(decision.insulin_mU_min)
            doses.append(delivered)
        runs.append(doses)
    assert np.ptp(runs[0]) > 20.0
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-7)


# ------------------------------------------------------------------------------------------- long horizons


def lqr(move_weight):
    """Gain on (x, u) of the moves that minimise sum (C x)^2 + Gu^2 du^2 for ever, and the loop's spectral radius."""
    transition = np.block([[PHI, GAMMA[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    effect = np.append(GAMMA, 1.0)[:, None]
    cost = np.outer(np.append(C, 0.0), np.append(C, 0.0))
    weight = np.array([[move_weight**2]])
    P = scipy.linalg.solve_discrete_are(transition, effect, cost, weight)
    K = np.linalg.solve(weight + effect.T @ P @ effect, effect.T @ P @ transition)
    return K[0], np.abs(np.linalg.eigvals(transition - effect @ K)).max()


def long_sighted(horizon, move_weight, insulin=1000.0):
    """No reference filter, no held innovation, and as many moves as samples ahead."""
    tuning = StateTuning(horizon, horizon, 1.0, move_weight, reference_filter=0.0, reference_start=0)
    limits = dose_limits(max_change_mU_min=1e4, max_mU_min=1e4)
    return design_mpc_se(linear(insulin), Q, tuning, limits, offset_free="none")


def first_moves(controller, states, insulin, setpoint):
    """First moves from given states, without a reading."""
    moves = []
    for x in states:
        # What the estimate is now, one sample of rest before: the step carries it forward.
        before = np.linalg.solve(PHI, x[:3] - GAMMA * x[3])
        state = dataclasses.replace(controller.init(observe(GLUCOSE, insulin)), estimate=jnp.asarray(before))
        _, decision = step(controller, state, observe(np.nan, insulin + x[3], setpoint, valid=False))
        moves.append(float(decision.insulin_mU_min) - insulin - x[3])
    return np.array(moves)


@pytest.mark.long
def test_with_long_horizons_the_first_move_is_the_linear_quadratic_one():
    K, radius = lqr(0.3)
    assert 0.8 < radius < 0.9
    states = np.random.default_rng(11).normal(0, [5.0, 5.0, 20.0, 5.0], (4, 4))
    setpoint = 84.0  # the regulator goes to the rest that belongs to it
    rest_u = (setpoint - GLUCOSE) / (C @ np.linalg.solve(np.eye(3) - PHI, GAMMA))
    rest = np.append(np.linalg.solve(np.eye(3) - PHI, GAMMA) * rest_u, rest_u)
    optimal = -(states - rest) @ K
    errors = {}
    for horizon in (8, 20, 40):
        found = first_moves(long_sighted(horizon, 0.3), states, 1000.0, setpoint)
        errors[horizon] = np.abs(found - optimal).max() / np.abs(optimal).max()
        # a finite horizon is as many steps of the Riccati difference equation, which contracts by the square
        assert errors[horizon] < 5.0 * radius ** (2 * horizon)
    assert errors[8] > errors[20] > errors[40]
    assert errors[8] > 1e-2
    assert errors[40] < 1e-5


def test_with_long_horizons_the_loop_is_that_of_the_linear_quadratic_gaussian_regulator():
    K, radius = lqr(0.3)
    L = kalman_gain()
    doses, readings = closed_loop(long_sighted(40, 0.3), 80, insulin=1000.0)
    z, u = np.zeros(3), 0.0
    expected = []
    for y in readings:
        z = PHI @ z + GAMMA * u
        z = z + L * (y - GLUCOSE - C @ z)
        u = u - K @ np.append(z, u)
        expected.append(1000.0 + u)
    assert np.ptp(doses) > 5.0
    np.testing.assert_allclose(doses, expected, atol=5.0 * radius**80 * np.ptp(expected))


# ------------------------------------------------------------------------------------------- one another


@pytest.mark.long
@pytest.mark.parametrize(
    ("tuning", "dead_time", "limits"),
    [
        (StateTuning(2, 8, 1.0, 0.3, 0.57, 1), 0, dose_limits(max_change_mU_min=3.0, max_mU_min=34.0)),
        (StateTuning(2, 8, 1.0, 1.0, 0.57, 0), 2, dose_limits(max_change_mU_min=2.0, min_mU_min=28.0)),
    ],
)
def test_on_a_linear_model_nonlinear_control_is_linear_control(tuning, dead_time, limits):
    imagined = LinearAsNonlinear(state=jnp.array([4.0, 2.0, 80.0]), insulin_mU_min=jnp.asarray(INSULIN))
    nonlinear = design_nlqdmc_se(imagined, Q, tuning, limits, dead_time_samples=dead_time)
    plain = design_mpc_se(linear(), Q, tuning, limits, dead_time_samples=dead_time, constraints="qp")
    for upset in (20.0, -12.0):
        found, expected = (
            closed_loop(controller, 60, upset=upset, setpoint=88.0)[0] for controller in (nonlinear, plain)
        )
        assert np.ptp(expected) > 3.0
        np.testing.assert_allclose(found, expected, atol=1e-8)
