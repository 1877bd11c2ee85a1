"""A record told to an estimator: as a controller would have told it, and columns that are none."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import Observation, design_meal_mpc
from glucoloop.estimation.unknown_meal import MealHabits, MovingHorizonSettings, design_meal_horizon, design_meal_kalman
from glucoloop.estimation.unknown_meal.replay import estimate_meals
from glucoloop.models.sensor_lag import behind_lag
from glucoloop.sensors.delay import lagged

N = 30


@pytest.mark.long
def test_it_says_what_the_controller_was_told(two_states):
    controller = design_meal_mpc(two_states, estimator=MovingHorizonSettings(horizon=5), dead_time_samples=2)
    rng = np.random.default_rng(2)
    readings = 80.0 + np.cumsum(rng.normal(0.3, 1.0, N))
    readings[7:9] = np.nan
    insulin, announced = rng.uniform(10.0, 30.0, N), np.where(np.arange(N) == 12, 9.0, 0.0)

    def observation(k):
        return Observation(
            glucose_mg_dl=jnp.asarray(readings[k]),
            valid=jnp.asarray(True),
            setpoint_mg_dl=jnp.asarray(80.0),
            delivered_mU_min=jnp.asarray(insulin[k - 1] if k else 20.0),
            announced_carbs_g=jnp.asarray(announced[k]),
        )

    @jax.jit
    def step(state, observation):
        later, _, estimate = controller.explained_step(state, observation)
        return dataclasses.replace(later, planned=state.planned), estimate  # what is planned makes no difference

    state = controller.init(observation(0))
    said = []
    for k in range(N):
        state, estimate = step(state, observation(k))
        said.append([estimate.eating, estimate.carbs_g, estimate.stomach.emptying_mg_min, estimate.disturbance_mg_min])
    told = estimate_meals(
        controller.model,
        controller.meal_estimator,
        5.0 * np.arange(N),
        readings,
        insulin,
        announced,
        dead_time_samples=2,
    )
    columns = [told.eating, told.carbs_g, told.emptying_mg_min, told.disturbance_mg_min]
    np.testing.assert_allclose(np.stack(columns, axis=1), np.array(said, float), rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def filtered(two_states):
    return design_meal_kalman(two_states)


@pytest.mark.long
@pytest.mark.parametrize("design", [design_meal_kalman, functools.partial(design_meal_horizon, horizon=3)])
def test_behind_a_known_lag_of_the_sensor_glucose_itself_is_estimated(two_states, design):
    insulin = 20.0 + np.repeat([0.0, 4.0, -4.0, 0.0], 9)
    x, glucose, behind = two_states.state, [80.0], [80.0]
    for rate in insulin[:-1]:
        x = two_states.advance(x, rate)
        glucose.append(float(x[0]))
        behind.append(float(lagged(behind[-1], glucose[-2], glucose[-1], 15.0, 5.0)))
    assert np.abs(np.subtract(glucose, behind)).max() > 5.0
    model, t_min = behind_lag(two_states, 15.0), 5.0 * np.arange(insulin.size)
    told = estimate_meals(model, design(model, MealHabits(meals_per_h=0.01)), t_min, behind, insulin)
    np.testing.assert_allclose(told.glucose_mg_dl, glucose, atol=0.2)


@pytest.mark.long
def test_what_came_before_is_told_by_its_rate(two_states, filtered):
    # at steady state under half the basal rate, glucose is where the model says it is, and nothing appears
    rest = 3.0 - 0.25 * 10.0 / 0.2, 80.0 + 0.6 * 0.25 * 10.0 / 0.2 / 0.08
    record = 5.0 * np.arange(N), np.full(N, rest[1]), np.full(N, 10.0)
    told = estimate_meals(two_states, filtered, *record, initial_insulin_mU_min=10.0)
    np.testing.assert_allclose(told.emptying_mg_min, 0.0, atol=1e-6)
    np.testing.assert_allclose(told.glucose_mg_dl, rest[1], rtol=1e-9)
    assert float(jnp.max(estimate_meals(two_states, filtered, *record).emptying_mg_min)) > 100.0


def test_the_last_rate_does_not_count(two_states, filtered):
    t, readings, insulin = 5.0 * np.arange(N), np.full(N, 82.0), np.full(N, 20.0)
    first = estimate_meals(two_states, filtered, t, readings, insulin)
    insulin[-1] = np.nan
    again = estimate_meals(two_states, filtered, t + 1440.0, readings, insulin)
    np.testing.assert_array_equal(first.eating, again.eating)


T = [0.0, 5.0, 10.0]


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (([], [], []), "a record without samples tells nothing"),
        ((T, [80.0, 80.0], [20.0] * 3), "3 times and 2 readings do not go together"),
        ((T, [80.0] * 3, [20.0]), "3 times and 1 insulin rates do not go together"),
        ((T, [80.0] * 3, [20.0] * 3, [0.0]), "3 times and 1 announced amounts do not go together"),
        ((T, ["a", "b", "c"], [20.0] * 3), "the readings are not all numbers"),
        ((T, [[80.0] * 3], [20.0] * 3), r"the readings have the shape \(1, 3\)"),
        (([0.0, 5.0, 11.0], [80.0] * 3, [20.0] * 3), "the times 5 and 11 min are not 5 min apart"),
        (([0.0, 10.0, 20.0], [80.0] * 3, [20.0] * 3), "the times 0 and 10 min are not 5 min apart"),
        (([np.nan, 5.0, 10.0], [80.0] * 3, [20.0] * 3), "the times nan and 5 min are not"),
        (([0.0, np.nan, 10.0], [80.0] * 3, [20.0] * 3), "the times 0 and nan min are not"),
        ((T, [80.0] * 3, [20.0, -1.0, 20.0]), "an insulin rate of -1 mU/min is not possible"),
        ((T, [80.0] * 3, [np.nan, 20.0, 20.0]), "an insulin rate of nan mU/min is not possible"),
        ((T, [80.0] * 3, [20.0] * 3, [0.0, np.inf, 0.0]), "an announced meal of inf g is not possible"),
    ],
)
def test_a_record_that_is_none_is_refused(two_states, filtered, columns, sentence):
    with pytest.raises(ValueError, match=sentence):
        estimate_meals(two_states, filtered, *columns)


@pytest.mark.parametrize(
    ("late", "sentence"),
    [
        (-1, "a dead time of -1 samples is not possible"),
        (1.0, "dead_time_samples is 1.0, a float; give a whole number"),
        (True, "dead_time_samples is True, a bool; give a whole number"),
    ],
)
def test_a_dead_time_that_cannot_be_is_refused(two_states, filtered, late, sentence):
    with pytest.raises(ValueError, match=sentence):
        estimate_meals(two_states, filtered, T, [80.0] * 3, [20.0] * 3, dead_time_samples=late)


def test_a_negative_rate_before_the_record_is_refused(two_states, filtered):
    with pytest.raises(ValueError, match="an insulin rate of -5 mU/min"):
        estimate_meals(two_states, filtered, T, [80.0] * 3, [20.0] * 3, initial_insulin_mU_min=-5.0)
