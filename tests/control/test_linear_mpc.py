import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.control import MPCTuning, Status, design_linear_mpc
from glucoloop.models.step_response import StepResponseModel
from mpc_rows import IMPULSE, WIDE, follow, observe

S = np.cumsum(IMPULSE)
MODEL = StepResponseModel.from_impulse_response(IMPULSE, 5.0)
TUNING = MPCTuning(2, 10, 3.0, 1.0)
step = jax.jit(lambda controller, state, observation: controller.step(state, observation))


def free_response(doses, start, ahead):
    """Deviation of glucose 0 .. ahead samples from now, from every change of dose so far, added up one by one."""
    moves, now = np.diff(np.r_[start, doses]), len(doses)
    held = np.r_[S, np.full(ahead + now, S[-1])]
    return np.array([sum(du * held[now - k + i - 1] for k, du in enumerate(moves)) for i in range(ahead + 1)])


def plan_by_hand(tuning, response):
    """First row of the solution of the stacked weighted problem, by least squares."""
    m, p = tuning.move_horizon, tuning.prediction_horizon
    held = np.r_[response, np.full(p, response[-1])]
    A = np.array([[held[i - j] if i >= j else 0.0 for j in range(m)] for i in range(p)])
    stacked = np.r_[tuning.output_weight * A, tuning.move_weight * np.eye(m)]
    right = np.r_[tuning.output_weight * np.eye(p), np.zeros((m, p))]
    return A, np.linalg.lstsq(stacked, right, rcond=None)[0]


@pytest.mark.parametrize(
    "tuning",
    [
        MPCTuning(2, 8, 1.0, 0.0),
        TUNING,
        MPCTuning(1, 3, 1.0, 0.0),
        MPCTuning(4, 20, 1.0, 0.3),
        MPCTuning(3, 60, 2.0, 5.0),
    ],
)
def test_gain_is_the_least_squares_solution(tuning):
    found = design_linear_mpc(MODEL, tuning).gain
    np.testing.assert_allclose(found, plan_by_hand(tuning, S)[1][0], rtol=1e-8, atol=1e-10)


def test_the_first_move_is_the_gain_times_the_error():
    controller = design_linear_mpc(MODEL, TUNING, WIDE)
    state = controller.init(observe(81.1, 25.0))
    _, decision = step(controller, state, observe(90.0, 25.0))
    assert float(decision.insulin_mU_min) == pytest.approx(25.0 + float(controller.gain.sum()) * (81.1 - 90.0))
    assert float(decision.insulin_mU_min) > 25.0


@settings(max_examples=30)
@given(st.lists(st.floats(40.0, 300.0), min_size=20, max_size=20))
def test_the_free_response_is_the_sum_of_what_was_delivered(readings):
    doses, _, state = follow(design_linear_mpc(MODEL, TUNING), np.array(readings), np.ones(20, bool), 25.0)
    given = np.asarray(doses)[:-1]  # the last one is not yet known to the controller
    expected = free_response(given, 25.0, 30)
    np.testing.assert_allclose(np.asarray(state.free_response)[-1, :31], expected, rtol=1e-9, atol=1e-9)
    assert float(state.disturbance_mg_dl[-1]) == pytest.approx(readings[-1] - expected[0], rel=1e-9)


def test_what_the_pump_delivered_counts_and_not_the_command():
    controller = design_linear_mpc(MODEL, TUNING)
    state = controller.init(observe(81.1, 25.0))
    state, decision = step(controller, state, observe(150.0, 25.0))
    assert float(decision.insulin_mU_min) == pytest.approx(41.7)
    state, _ = step(controller, state, observe(150.0, 28.0))  # the pump gave less
    np.testing.assert_allclose(state.free_response[:36], 3.0 * S, rtol=1e-12)
    assert float(state.insulin_mU_min) == 28.0


@settings(max_examples=30)
@given(st.lists(st.floats(40.0, 300.0), min_size=20, max_size=20))
def test_without_limits_the_exact_program_is_the_closed_form(readings):
    clipped, solved = (
        follow(design_linear_mpc(MODEL, TUNING, WIDE, constraints=way), np.array(readings), np.ones(20, bool), 5e5)[0]
        for way in ("clip", "qp")
    )
    np.testing.assert_allclose(solved, clipped, rtol=1e-11)


def planned(tuning, error, delivered, dose):
    """Minimum objective of any allowed plan that begins with this dose, the later moves by a general solver."""
    A, _ = plan_by_hand(tuning, S)
    first = dose - delivered

    def objective(later):
        du = np.r_[first, later]
        return tuning.output_weight**2 * np.sum((error - A @ du) ** 2) + tuning.move_weight**2 * np.sum(du**2)

    def slope(later):
        du = np.r_[first, later]
        return (-2.0 * tuning.output_weight**2 * A.T @ (error - A @ du) + 2.0 * tuning.move_weight**2 * du)[1:]

    return scipy.optimize.minimize(
        objective,
        np.zeros(tuning.move_horizon - 1),
        jac=slope,
        method="SLSQP",
        bounds=[(-16.7, 16.7)] * (tuning.move_horizon - 1),
        constraints=[
            {"type": "ineq", "fun": lambda later: dose + np.cumsum(later)},
            {"type": "ineq", "fun": lambda later: 66.9 - dose - np.cumsum(later)},
        ],
        options={"ftol": 1e-12, "maxiter": 200},
    ).fun


def both_plans(tuning, glucose, past):
    """Objectives of the plans that begin with the clipped dose and with the exact one, after past doses."""
    free = free_response(past[1:], past[0], tuning.prediction_horizon)
    error = 81.1 - (glucose - free[0]) - free[1:]
    for constraints in ("clip", "qp"):
        controller = design_linear_mpc(MODEL, tuning, constraints=constraints)
        state = controller.init(observe(81.1, past[0]))
        for dose in past[1:]:
            state, decision = step(controller, state, observe(glucose, dose))
        yield planned(tuning, error, past[-1], float(decision.insulin_mU_min))


@pytest.mark.long
@pytest.mark.parametrize("tuning", [TUNING, MPCTuning(2, 8, 1.0, 0.0), MPCTuning(3, 9, 1.0, 0.2)])
@settings(max_examples=25)
@given(glucose=st.floats(20.0, 400.0), past=st.lists(st.floats(0.0, 66.9), min_size=4, max_size=4))
def test_the_exact_program_never_plans_worse_than_clipping(tuning, glucose, past):
    clipped, exact = both_plans(tuning, glucose, past)
    assert exact <= clipped * (1.0 + 1e-6) + 1e-6


def test_the_exact_program_plans_better_where_a_later_move_meets_a_limit():
    clipped, exact = both_plans(MPCTuning(2, 8, 1.0, 0.0), 84.0, [25.0, 42.0, 58.0, 42.0])
    assert exact < 0.99 * clipped


# ---------------------------------------------------------------------------------------------- dead time


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_a_known_dead_time_only_moves_the_gain_later(samples):
    original = design_linear_mpc(MODEL, TUNING).gain
    delayed = design_linear_mpc(MODEL.delayed(samples), MPCTuning(2, 10 + samples, 3.0, 1.0)).gain
    np.testing.assert_allclose(delayed, np.r_[np.zeros(samples), original], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("samples", [1, 3])
def test_a_known_dead_time_shifts_the_answer_and_nothing_else(samples):
    """On a plant that is the model, a change of setpoint calls for the same doses with and without dead time."""
    controller = design_linear_mpc(MODEL.delayed(samples), MPCTuning(2, 10 + samples, 3.0, 1.0), WIDE)
    state, delivered, doses = controller.init(observe(100.0, 25.0, 100.0)), 25.0, []
    for k in range(100):
        late = free_response(doses[: max(0, k - samples)], 25.0, 0)[0] if k > samples else 0.0
        state, decision = step(controller, state, observe(100.0 + late, delivered, 90.0))
        delivered = float(decision.insulin_mU_min)
        doses.append(delivered)
    assert free_response(doses, 25.0, 0)[0] == pytest.approx(-10.0, abs=1e-3)
    reference, told, expected = design_linear_mpc(MODEL, TUNING, WIDE), 25.0, []
    state = reference.init(observe(100.0, 25.0, 100.0))
    for _ in range(100):
        now = free_response(expected, 25.0, 0)[0] if expected else 0.0
        state, decision = step(reference, state, observe(100.0 + now, told, 90.0))
        told = float(decision.insulin_mU_min)
        expected.append(told)
    np.testing.assert_allclose(doses, expected, rtol=1e-9)


# ---------------------------------------------------------------------------------------------- bad readings

READING = st.tuples(
    st.one_of(st.floats(20.0, 500.0), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -50.0, 1e9, 1e308])), st.booleans()
)


@pytest.mark.parametrize("constraints", ["clip", "qp"])
@settings(max_examples=60)
@given(st.lists(READING, min_size=16, max_size=16), st.floats(0.0, 66.9))
def test_whatever_is_read_the_dose_keeps_the_limits(constraints, readings, start):
    controller = design_linear_mpc(MODEL, TUNING, constraints=constraints)
    glucose, valid = np.array([g for g, _ in readings]), np.array([v for _, v in readings])
    doses, decision, state = follow(controller, glucose, valid, start)
    commands = np.asarray(decision.insulin_mU_min)
    for rates in (np.asarray(doses), commands):
        assert np.all((rates >= 0.0) & (rates <= 66.9))
    assert np.abs(np.diff(np.r_[start, doses])).max() <= 16.7 + 1e-12
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(state))
    missing = ~valid | ~np.isfinite(glucose)
    status = np.asarray(decision.status)
    assert np.all(np.isin(status[missing], [Status.READING_MISSING, Status.NON_FINITE]))
    assert np.all(status[~missing] != Status.READING_MISSING)


def test_a_missing_reading_is_bridged_by_the_model():
    """With a plant that is the model, losing readings changes nothing."""
    controller = design_linear_mpc(MODEL, TUNING)
    runs = []
    for lost in (set(), {3, 4, 5, 11}):
        state, delivered, doses = controller.init(observe(81.1, 25.0)), 25.0, []
        for k in range(20):
            now = free_response(doses, 25.0, 0)[0] if doses else 0.0
            reading = np.nan if k in lost else 89.0 + now
            state, decision = step(controller, state, observe(reading, delivered, valid=k not in lost))
            delivered = float(decision.insulin_mU_min)
            doses.append(delivered)
        runs.append(doses)
    np.testing.assert_allclose(runs[1], runs[0], rtol=1e-9)


def test_the_first_reading_may_be_missing():
    controller = design_linear_mpc(MODEL, TUNING)
    state = controller.init(observe(np.nan, 25.0, valid=False))
    _, decision = step(controller, state, observe(np.nan, 25.0, valid=False))
    assert float(decision.insulin_mU_min) == pytest.approx(25.0)
    assert int(decision.status) == Status.READING_MISSING


def test_a_pump_that_does_not_tell_its_rate_is_taken_at_its_last_word():
    controller = design_linear_mpc(MODEL, TUNING)
    state, decision = step(controller, controller.init(observe(81.1, 25.0)), observe(85.0, np.nan))
    assert float(state.insulin_mU_min) == 25.0
    assert np.isfinite(float(decision.insulin_mU_min))


def test_statuses():
    controller = design_linear_mpc(MODEL, TUNING)
    state = controller.init(observe(81.1, 25.0))
    status = {
        Status.OK: step(controller, state, observe(81.5, 25.0)),
        Status.SATURATED: step(controller, state, observe(300.0, 25.0)),
        Status.READING_MISSING: step(controller, state, observe(300.0, 25.0, valid=False)),
        Status.NON_FINITE: step(controller, state, observe(300.0, 25.0, setpoint=np.nan)),
    }
    for expected, (_, decision) in status.items():
        assert Status(int(decision.status)) is expected
    assert float(status[Status.SATURATED][1].insulin_mU_min) == pytest.approx(41.7)
    assert float(status[Status.NON_FINITE][1].insulin_mU_min) == 25.0
    assert all(len(status.text) > 20 for status in Status)


# ---------------------------------------------------------------------------------------------- windup


def test_a_long_saturation_leaves_no_lag():
    """Told the same readings and doses, a controller that was cut for hours is one that never was."""
    tight, wide = design_linear_mpc(MODEL, TUNING), design_linear_mpc(MODEL, TUNING, WIDE)
    readings = np.r_[np.full(48, 45.0), np.linspace(45.0, 95.0, 12), np.full(12, 81.1)]
    doses, decision, state = follow(tight, readings, np.ones(72, bool), 25.0)
    assert np.all(np.asarray(decision.status)[1:40] == Status.SATURATED)
    assert np.all(np.asarray(doses)[2:40] == 0.0)

    told, never = np.r_[25.0, np.asarray(doses)], wide.init(observe(readings[0], 25.0))
    wanted = []
    for k, reading in enumerate(readings):
        never, free = step(wide, never, observe(reading, told[k]))
        wanted.append(float(free.insulin_mU_min))
    allowed = np.clip(np.clip(wanted, told[:-1] - 16.7, told[:-1] + 16.7), 0.0, 66.9)
    np.testing.assert_allclose(doses, allowed, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(state.free_response[-1], never.free_response, rtol=1e-9, atol=1e-9)
    assert np.asarray(doses)[48:].max() > 25.0


# ---------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((3, 2, 1.0, 0.0), r"prediction horizon of 2 .* move horizon of 3; give a whole number from 3 to 288"),
        ((0, 8, 1.0, 0.0), r"move_horizon is 0; give a whole number from 1 to 50"),
        ((51, 80, 1.0, 0.0), r"move_horizon is 51; give a whole number from 1 to 50"),
        ((2, 289, 1.0, 0.0), r"prediction_horizon is 289; give"),
        ((2, 8, 0.0, 0.0), r"output_weight is 0; give a finite number above 0"),
        ((2, 8, -1.0, 0.0), r"output_weight is -1; give"),
        ((2, 8, np.nan, 0.0), r"output_weight is nan; give"),
        ((2, 8, 1.0, -0.1), r"move_weight is -0.1; give a finite number of 0 or more"),
        ((2, 8, 1.0, np.inf), r"move_weight is inf; give"),
        ((2, 8, 1.0, np.nan), r"move_weight is nan; give"),
    ],
)
def test_a_tuning_out_of_bounds_is_refused(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        MPCTuning(*arguments)


def test_an_unknown_way_of_handling_constraints_is_refused():
    with pytest.raises(ValueError, match=r"constraints is 'soft'; give clip or qp"):
        design_linear_mpc(MODEL, constraints="soft")


def test_a_model_in_which_insulin_raises_glucose_is_refused():
    raised = dataclasses.replace(MODEL, step_response=-MODEL.step_response)
    with pytest.raises(ValueError, match=r"gain of \S+ mg/dl per mU/min is not possible; insulin lowers glucose"):
        design_linear_mpc(raised, TUNING)


@pytest.mark.parametrize("samples", [7, 8, 20])
@pytest.mark.parametrize("move_weight", [0.0, 3.0])
def test_a_dead_time_as_long_as_the_horizon_is_refused(samples, move_weight):
    told = (
        r"a prediction horizon of 8 samples sees \S+ % of the gain of insulin; .*give a prediction horizon of (\d+) or"
    )
    with pytest.raises(ValueError, match=told) as refused:
        design_linear_mpc(MODEL.delayed(samples), MPCTuning(2, 8, 1.0, move_weight))
    enough = int(re.search(told, str(refused.value))[1])
    design_linear_mpc(MODEL.delayed(samples), MPCTuning(2, enough, 1.0, move_weight))
    with pytest.raises(ValueError, match=f"horizon of {enough - 1} samples sees"):
        design_linear_mpc(MODEL.delayed(samples), MPCTuning(2, enough - 1, 1.0, move_weight))


def test_a_model_that_is_not_finite_is_refused():
    model = StepResponseModel(step_response=jnp.array([-0.1, np.nan, -0.3]), sample_time_min=5.0)
    with pytest.raises(ValueError, match="not finite; identify the model again"):
        design_linear_mpc(model, MPCTuning(1, 2))


def test_a_model_without_any_response_is_refused():
    with pytest.raises(ValueError, match="a gain of 0 mg/dl per mU/min is not possible"):
        design_linear_mpc(StepResponseModel.from_impulse_response(np.zeros(5), 5.0), MPCTuning(1, 4))
