"""The soft floor under predicted glucose: what it adds to the plan, and that nothing changes without it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import (
    LinearMPC,
    MPCTuning,
    StateTuning,
    Status,
    design_linear_mpc,
    design_mpc_se,
    design_nlqdmc_se,
)
from glucoloop.models.state_space import LinearModel
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps import PARKER_1999_LIMITS
from glucoloop.qp import minimise_moves_above_floor, soft_floor
from glucoloop.simulation import nonlinear_model
from glucoloop.tuning.search import _padded
from observing import observing

IMPULSE = -0.12 * (np.exp(-np.arange(1, 37) / 9.0) - np.exp(-np.arange(1, 37) / 3.0))
MODEL = StepResponseModel.from_impulse_response(IMPULSE, 5.0)
TUNING = MPCTuning(2, 10, 3.0, 1.0)
STATE = LinearModel(
    Phi=jnp.array([[0.8, 0.0], [-0.3, 0.9]]),
    Gamma=jnp.array([0.2, -0.05]),
    C=jnp.array([0.0, 1.0]),
    state=jnp.zeros(2),
    insulin_mU_min=jnp.array(25.0),
    glucose_mg_dl=jnp.array(81.0),
    sample_time_min=5.0,
)
STATE_TUNING = StateTuning(2, 8, 1.0, 0.3, 0.65)
BASAL = 25.606057344
LIMITS = {"max_move": 16.7, "u_min": 0.0, "u_max": 66.9}

step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
solve = jax.jit(minimise_moves_above_floor)
observe = observing(setpoint=81.0)


def linear(**settings):
    return design_linear_mpc(MODEL, TUNING, **settings)


def estimating(**settings):
    return design_mpc_se(STATE, [1.0, 1.0], STATE_TUNING, **settings)


def in_a_row(controller, readings, start=25.0, setpoint=81.0):
    """Decisions of a controller whose doses are delivered."""
    state, delivered, found = controller.init(observe(readings[0], start, setpoint)), start, []
    for reading in readings:
        state, decision = step(controller, state, observe(reading, delivered, setpoint))
        delivered = float(decision.insulin_mU_min)
        found.append((delivered, int(decision.status)))
    return np.array(found).T


NEAR = [72.0, 71.0, 70.5, 70.0, 69.0, 70.0, 71.0, 70.5]
FALLING = [81.0, 78.0, 74.0, 69.0, 65.0, 62.0, 60.0, 58.0, 61.0, 66.0]


@pytest.mark.parametrize("design", [linear, estimating])
@pytest.mark.parametrize("constraints", ["clip", "qp"])
def test_no_floor_leaves_the_controller_as_it_was(design, constraints):
    plain, none = design(constraints=constraints), design(constraints=constraints, glucose_floor_mg_dl=0.0)
    assert jax.tree.structure(plain) == jax.tree.structure(none)
    assert plain.plan.floor is None
    assert plain.plan.response is None
    np.testing.assert_array_equal(in_a_row(plain, FALLING), in_a_row(none, FALLING))


@pytest.mark.long
@pytest.mark.parametrize("design", [linear, estimating])
def test_a_floor_far_below_leaves_the_best_moves(design):
    np.testing.assert_allclose(
        in_a_row(design(glucose_floor_mg_dl=1.0), FALLING), in_a_row(design(constraints="qp"), FALLING), rtol=1e-12
    )


def test_the_plan_is_the_program_of_the_predicted_glucose():
    controller = linear(glucose_floor_mg_dl=70.0, floor_weight=4.0)
    state = controller.init(observe(70.0, 30.0))
    _, decision = step(controller, state, observe(70.0, 38.0, 64.0))  # 8 more than the controller knew of
    S = np.asarray(MODEL.step_response)
    predicted = 70.0 + 8.0 * (S[1:11] - S[0])  # the reading stands for now; the move goes on to act
    A = np.array([[S[i], S[i - 1] if i else 0.0] for i in range(10)])
    H, f = 9.0 * A.T @ A + np.eye(2), -9.0 * A.T @ (64.0 - predicted)
    wanted = solve(H, f, A, 70.0 - predicted, 4.0, 38.0, **LIMITS)
    without = solve(H, f, A, 0.0 - predicted, 4.0, 38.0, **LIMITS)
    assert float(decision.insulin_mU_min) == pytest.approx(38.0 + float(wanted.moves[0]), abs=1e-9)
    assert float(wanted.moves[0]) < float(without.moves[0]) - 1.0


@jax.jit
def on_its_own_model(controller):
    """Glucose of a plant that is the model itself, about 70 mg/dl under 25 mU/min, when 50 are asked for."""
    S = jnp.asarray(MODEL.step_response)

    def read(free, delivered):
        return observe(70.0 + free[0], delivered, 50.0)

    def sample(carry, _):
        state, free, delivered = carry
        state, decision = controller.step(state, read(free, delivered))
        moved = jnp.concatenate([free[1:], free[-1:]]) + S * (decision.insulin_mU_min - delivered)
        return (state, moved, decision.insulin_mU_min), 70.0 + moved[0]

    rest, basal = jnp.zeros(36), jnp.asarray(25.0)
    return jax.lax.scan(sample, (controller.init(read(rest, basal)), rest, basal), None, length=150)[1]


@pytest.mark.parametrize("weight", [1.0, 10.0])
def test_at_rest_glucose_lies_between_setpoint_and_floor_by_their_weights(weight):
    glucose = on_its_own_model(linear(glucose_floor_mg_dl=60.0, floor_weight=weight))
    rest = (9.0 * 50.0 + weight**2 * 60.0) / (9.0 + weight**2)  # where the two slopes cancel
    assert float(glucose[-1]) == pytest.approx(rest, abs=1e-6)


def test_with_estimation_predicted_glucose_is_glucose_and_no_deviation():
    low, high = (in_a_row(estimating(glucose_floor_mg_dl=floor), [81.0] * 4, setpoint=60.0)[0] for floor in (1.0, 75.0))
    plain = in_a_row(estimating(constraints="qp"), [81.0] * 4, setpoint=60.0)[0]
    np.testing.assert_allclose(low, plain, rtol=1e-12)
    assert np.all(high[1:] < plain[1:] - 1.0)


@pytest.fixture(scope="module")
def imagined(patient_81):
    return nonlinear_model(patient_81)


def nonlinear(imagined, **settings):
    return design_nlqdmc_se(imagined, np.repeat([0.9, 0.01, 0.005], [8, 9, 2]), StateTuning(2, 5), **settings)


@pytest.mark.long
def test_the_nonlinear_controller_keeps_a_floor(imagined):
    observation, doses = observe(81.1, BASAL, 77.0), []
    for floor in (0.0, 1.0, 79.0):
        controller = nonlinear(imagined, glucose_floor_mg_dl=floor)
        assert (controller.floor is None) == (floor == 0.0)
        _, decision = step(controller, controller.init(observation), observation)
        assert int(decision.status) == Status.OK
        doses.append(float(decision.insulin_mU_min))
    without, far, near = doses
    assert far == pytest.approx(without, abs=1e-9)
    assert BASAL < near < without - 1.0
    # a padded one looks at more samples, but for the floor at its own alone
    np.testing.assert_array_equal(_padded(controller, 2, 7).floor.weight, [10.0] * 5 + [0.0] * 2)


@pytest.mark.long
@pytest.mark.parametrize("design", [linear, estimating])
def test_a_padded_controller_keeps_its_floor(design):
    controller = design(glucose_floor_mg_dl=70.0)
    own = in_a_row(controller, NEAR, setpoint=64.0)
    assert np.max(np.abs(own[0] - in_a_row(design(constraints="qp"), NEAR, setpoint=64.0)[0])) > 0.5
    np.testing.assert_allclose(in_a_row(_padded(controller, 2, 13), NEAR, setpoint=64.0), own, rtol=0.0, atol=1e-9)


def test_people_have_the_controllers_that_each_has_alone():
    S = np.cumsum(IMPULSE)[:, None] * np.array([1.0, 1.4])
    settings = {"glucose_floor_mg_dl": 70.0, "floor_weight": 5.0}
    tuned, _ = LinearMPC().tuned(TUNING, **settings)
    people = tuned.of_people(S, PARKER_1999_LIMITS, sample_time_min=5.0)
    for i, strength in enumerate((1.0, 1.4)):
        model = StepResponseModel.from_impulse_response(strength * IMPULSE, 5.0)
        alone = design_linear_mpc(model, TUNING, **settings)
        np.testing.assert_allclose(people.plan.response[..., i], alone.plan.response, rtol=1e-12)
        assert people.plan.floor == alone.plan.floor


def test_a_missing_reading_is_ridden_through():
    controller = linear(glucose_floor_mg_dl=70.0)
    state = controller.init(observe(75.0, 25.0))
    state, _ = step(controller, state, observe(75.0, 25.0))
    state, decision = step(controller, state, observe(np.nan, 25.0, valid=False))
    assert int(decision.status) == Status.READING_MISSING
    assert np.isfinite(decision.insulin_mU_min)


def test_a_plan_that_is_not_the_best_is_told(monkeypatch):
    controller = linear(glucose_floor_mg_dl=66.0, floor_weight=4.0)
    state, observation = controller.init(observe(72.0, 30.0)), observe(72.0, 38.0, 64.0)
    assert int(step(controller, state, observation)[1].status) == Status.OK
    monkeypatch.setattr(soft_floor, "ROUNDS", 1)
    _, decision = jax.jit(lambda *given: controller.step(*given))(state, observation)
    assert int(decision.status) == Status.NOT_CONVERGED
    assert 38.0 - 16.7 <= float(decision.insulin_mU_min) <= 38.0 + 16.7


@pytest.mark.parametrize("floor", [-1.0, np.nan, np.inf])
def test_floors_that_are_not_possible_are_refused(floor, imagined):
    for design in (linear, estimating, lambda **settings: nonlinear(imagined, **settings)):
        with pytest.raises(ValueError, match=r"glucose_floor_mg_dl is .*; give a finite number of 0 mg/dl or more"):
            design(glucose_floor_mg_dl=floor)


@pytest.mark.parametrize("weight", [0.0, -1.0, np.nan, np.inf])
def test_weights_that_are_not_possible_are_refused(weight):
    with pytest.raises(ValueError, match=r"floor_weight is .*; give a finite number above 0"):
        linear(glucose_floor_mg_dl=60.0, floor_weight=weight)
