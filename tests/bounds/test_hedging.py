"""Two-scenario bound under sensor noise: the doses for two worlds."""

from itertools import islice

import numpy as np
import pytest
from scipy.optimize import linprog

import glucoloop as gl
from glucoloop.bounds import hedged_doses
from glucoloop.bounds.hedging import LARGER, _first_distinct
from glucoloop.bounds.trajectory import trajectory_of
from glucoloop.pumps.limits import PARKER_1999_LIMITS

HORIZON_MIN = 200.0
SMALL = gl.Scenario([gl.Meal(10.0, 80.0)], HORIZON_MIN)
TINY = gl.Scenario([gl.Meal(0.5, 80.0)], HORIZON_MIN)
BASAL = 25.60605734419632


@pytest.fixture(scope="module")
def hedged():
    """Of a meal that is over within the run, seen through little noise; of its end with one error."""
    return {(of.question, of.error): of for of in islice(hedged_doses(gl.patient(), SMALL, 0.02), 3)}


@pytest.mark.parametrize("error", [0.25, 0.05])
def test_best_test_is_wrong_so_often(error):
    # the likelihood ratio of drawn readings, with the first sample that is enough and with those before it
    rng = np.random.default_rng(2)
    difference = 0.15 * np.maximum(np.arange(30.0) - 5.0, 0.0)
    first = _first_distinct(difference, 1.45, error)
    meal = rng.random(60_000) < 0.5
    readings = meal[:, None] * difference + rng.normal(0.0, np.sqrt(1.45), (meal.size, 30))
    evidence = np.cumsum(difference * (readings - difference / 2.0), axis=1) > 0.0
    wrong = np.mean(evidence != meal[:, None], axis=0)
    assert wrong[first] < error + 0.005
    assert wrong[first - 1] > error - 0.005
    assert _first_distinct(np.zeros(30), 1.45, error) == 30


def test_doses_are_the_same_until_the_worlds_are_told_apart(hedged):
    for of in hedged.values():
        first = int((80.0 + of.distinguished_after_min) / 5.0)
        np.testing.assert_array_equal(of.meal.insulin_mU_min[:first], of.other.insulin_mU_min[:first])
        assert abs(of.meal.insulin_mU_min[first] - of.other.insulin_mU_min[first]) > 0.1
        np.testing.assert_allclose(of.meal.insulin_mU_min[:16], BASAL, rtol=1e-12)
        assert of.meal.within(PARKER_1999_LIMITS)
        assert of.other.within(PARKER_1999_LIMITS)
        assert of.converged


def test_deviation_is_that_of_the_worse_world(hedged):
    for (question, _), of in hedged.items():
        eaten = [] if question == "begins" else [gl.Meal(10.0 * LARGER, 80.0)]
        course = trajectory_of(gl.patient(), SMALL, 5.0, [SMALL.meals, eaten])
        doses = np.stack([of.meal.insulin_mU_min, of.other.insulin_mU_min], axis=1)
        deviation = np.abs(course.glucose_mg_dl(doses) - 81.1).max()
        assert of.deviation_mg_dl - 1e-9 <= deviation <= of.deviation_mg_dl + 0.001
    assert hedged["begins", 0.05].other.undershoot_mg_dl > 0.5  # somebody who eats nothing pays for it


def test_the_surer_the_later_and_the_worse(hedged):
    some, all_ = hedged["begins", 0.25], hedged["begins", 0.05]
    assert some.distinguished_after_min < all_.distinguished_after_min < hedged["ends", 0.25].distinguished_after_min
    assert some.deviation_mg_dl < all_.deviation_mg_dl


def test_small_meal_agrees_with_a_linear_program():
    # Half a gram is little enough for the linear patient, with a model of its own for insulin.
    patient, n, first = gl.patient(), 40, 16
    of = next(hedged_doses(patient, TINY, 0.002, errors=[0.1]))
    apart = int((80.0 + of.distinguished_after_min) / 5.0)
    course = trajectory_of(patient, TINY, 5.0, [TINY.meals])
    meal = course.glucose_mg_dl(np.full((n, 1), BASAL))[:, 0] - 81.1
    model = gl.linear_model(patient, sample_time_min=1.0)
    x, impulse = np.zeros(model.Phi.shape[0]), [0.0]
    for minute in range(200):
        x = np.asarray(model.Phi) @ x + np.asarray(model.Gamma) * (minute < 5)
        impulse.append(float(np.asarray(model.C) @ x))
    response = np.zeros((201, n))
    for dose in range(n):
        response[5 * dose :, dose] = impulse[: 201 - 5 * dose]
    # doses of both worlds, one after the other, and the deviation
    none, t = np.zeros((201, n)), -np.ones((201, 1))
    rows = [[response, none, t], [-response, none, t], [none, response, t], [none, -response, t]]
    moves = np.hstack([np.kron(np.eye(2), np.diff(np.eye(n), axis=0)), np.zeros((2 * (n - 1), 1))])
    A = np.vstack([np.block(rows), moves, -moves])
    b = np.concatenate([-meal, meal, np.zeros(2 * 201), np.full(4 * (n - 1), 16.7)])
    same = np.hstack([np.eye(n), -np.eye(n), np.zeros((n, 1))])[:apart]
    bounds = ([(0.0, 0.0)] * first + [(-BASAL, 66.9 - BASAL)] * (n - first)) * 2 + [(0.0, None)]
    found = linprog(np.eye(2 * n + 1)[-1], A, b, same, np.zeros(apart), bounds=bounds, method="highs")
    assert of.deviation_mg_dl == pytest.approx(found.fun, rel=0.015)
    free = linprog(np.eye(2 * n + 1)[-1], A, b, same[:first], np.zeros(first), bounds=bounds, method="highs")
    assert found.fun > 1.3 * free.fun  # so that it is the sharing that is seen
    bounds[:apart] = [(0.0, 0.0)] * apart
    waiting = linprog(np.eye(2 * n + 1)[-1], A, b, same, np.zeros(apart), bounds=bounds, method="highs")
    assert found.fun < 0.8 * waiting.fun  # and not that he waits


def test_late_readings_tell_as_much_later(hedged):
    late = next(hedged_doses(gl.patient(), SMALL, 0.02, errors=[0.25], dead_time_min=10.0))
    prompt = hedged["begins", 0.25]
    assert late.distinguished_after_min == prompt.distinguished_after_min + 10.0
    assert late.deviation_mg_dl > prompt.deviation_mg_dl


def test_what_noise_hides_is_never_told():
    never = next(hedged_doses(gl.patient(), TINY, 1e4, errors=[0.05]))
    assert never.distinguished_after_min == np.inf
    np.testing.assert_array_equal(never.meal.insulin_mU_min, never.other.insulin_mU_min)


@pytest.mark.parametrize(
    ("scenario", "noise_variance", "settings", "told"),
    [
        (gl.Scenario(()), 1.45, {}, "is for one meal, and the scenario has 0"),
        (gl.Scenario([gl.Meal(1, 1), gl.Meal(2, 2)]), 1.45, {}, "the scenario has 2"),
        (gl.Scenario(setpoint_mg_dl=100.0), 1.45, {}, "does not rest at the setpoint"),
        (gl.Scenario(), 0.0, {}, "a noise variance of 0 tell a meal at once, or never"),
        (gl.Scenario(), float("nan"), {}, "give a finite value above 0"),
        (gl.Scenario(), 1.45, {"errors": [0.5]}, "an error of 0.5 is not possible"),
        (gl.Scenario(), 1.45, {"dead_time_min": -5.0}, "a dead time of -5 min is not possible"),
    ],
)
def test_what_cannot_be_is_refused(scenario, noise_variance, settings, told):
    with pytest.raises(ValueError, match=told):
        hedged_doses(gl.patient(), scenario, noise_variance, **settings)
