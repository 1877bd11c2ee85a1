"""PID with insulin feedback: the printed model of insulin, the formula in plain Python, and any input."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.control import PIDIFB, Observation
from glucoloop.control.pid_ifb import FEEDBACK, insulin_lags
from glucoloop.pumps import dose_limits
from glucoloop.therapy import Profile

TARGET, BASAL, EVERY = 110.0, 15.0, 5.0
WIDE = dose_limits(max_change_mU_min=1e5, max_mU_min=1e6)
PROFILE = Profile(basal_mU_min=BASAL, setpoint_mg_dl=TARGET, total_daily_dose_U=45.0, carb_ratio_g_U=10.0)
CONTROLLER = PIDIFB().of_person(PROFILE, WIDE)
step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
ANY = st.one_of(st.floats(), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300]))


def observe(glucose=TARGET, *, delivered=BASAL, carbs=0.0, bolus=0.0, valid=True, setpoint=TARGET):
    return Observation(
        glucose_mg_dl=jnp.asarray(glucose, float),
        valid=jnp.asarray(valid),
        setpoint_mg_dl=jnp.asarray(setpoint, float),
        delivered_mU_min=jnp.asarray(delivered, float),
        announced_carbs_g=jnp.asarray(carbs, float),
        delivered_bolus_mU=jnp.asarray(bolus, float),
    )


def follow(controller, readings, *, carbs=None):
    """Rates and boluses of a loop whose pump delivers what is asked for."""
    state, rate, bolus, rates, boluses = controller.init(observe(readings[0])), BASAL, 0.0, [], []
    for k, y in enumerate(readings):
        told = carbs or {}
        state, decision = step(controller, state, observe(y, delivered=rate, bolus=bolus, carbs=told.get(k, 0.0)))
        rate, bolus = float(decision.insulin_mU_min), float(decision.bolus_mU)
        rates.append(rate)
        boluses.append(bolus)
    return np.array(rates), np.array(boluses)


def test_in_steps_of_a_minute_the_model_is_the_printed_one():
    """Ruiz et al. (2012) print the matrix; their insulin is in U/h and the rate in U/min, hence 60."""
    Phi, Gamma = insulin_lags(1.0)
    printed = [[0.9802, 0.0, 0.0], [0.014043, 0.98582, 0.0], [0.000127, 0.017889, 0.98198]]
    np.testing.assert_allclose(Phi, printed, atol=6e-6)
    np.testing.assert_allclose(60.0 * Gamma, [1.1881, 0.0084741, 0.00005], rtol=2e-2, atol=6e-5)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.floats(90.0, 250.0), min_size=12, max_size=12))
def test_it_is_the_formula(readings):
    Phi, Gamma = insulin_lags(EVERY)
    gain = 45.0 * 1000.0 / 1500.0 / 90.0
    insulin, integral, last, rate, expected = np.full(3, BASAL), BASAL, readings[0], BASAL, []
    for y in readings:
        insulin = Phi @ insulin + Gamma * rate
        grown = integral + gain * (y - TARGET) * EVERY / 450.0
        v = gain * (y - TARGET) + grown + gain * 90.0 * (y - last) / EVERY
        wanted = (1.0 + sum(FEEDBACK)) * v - np.dot(FEEDBACK, insulin)
        if wanted > 0.0 or y >= TARGET:
            integral = max(grown, 0.0)
        last, rate = y, max(wanted, 0.0)
        expected.append(rate)
    np.testing.assert_allclose(follow(CONTROLLER, readings)[0], expected, rtol=1e-9, atol=1e-9)


def test_at_rest_the_feedback_changes_nothing():
    for feedback in (0.0, 1.0, 2.0):
        rates, _ = follow(PIDIFB(feedback=feedback).of_person(PROFILE, WIDE), np.full(30, TARGET))
        np.testing.assert_allclose(rates, BASAL, rtol=1e-12)


def test_insulin_of_a_meal_bolus_lowers_the_rate_after_it_by_what_is_still_to_act():
    readings = np.full(60, TARGET + 40.0)
    rates, boluses = follow(CONTROLLER, readings, carbs={2: 50.0})
    assert np.flatnonzero(boluses).tolist() == [2]
    assert boluses[2] == pytest.approx(5000.0)
    without, none = follow(PIDIFB(meal_bolus=0.0).of_person(PROFILE, WIDE), readings, carbs={2: 50.0})
    assert not none.any()
    np.testing.assert_array_equal(rates[:3], without[:3])
    assert np.all(rates[3:30] < without[3:30])


def test_gain_and_ratio_follow_the_profile_and_a_given_ratio_stays():
    twice = CONTROLLER.with_profile(dataclasses.replace(PROFILE, total_daily_dose_U=90.0, carb_ratio_g_U=5.0))
    assert float(twice.proportional()) == pytest.approx(2.0 * float(CONTROLLER.proportional()))
    assert float(twice.carbs_per_U) == 5.0
    given_ratio = PIDIFB(carb_ratio_g_U=8.0).of_person(PROFILE, WIDE).with_profile(PROFILE)
    assert float(given_ratio.carbs_per_U) == 8.0
    people = CONTROLLER.with_basal(jnp.asarray([7.0, 14.0]))
    np.testing.assert_allclose(people.daily_dose_U, [20.16, 40.32])


@settings(max_examples=100, deadline=None)
@given(numbers=st.tuples(ANY, ANY, ANY, ANY, ANY), valid=st.booleans())
def test_whatever_is_told_doses_are_possible_and_the_memory_is_sound(numbers, valid):
    glucose, carbs, bolus, delivered, setpoint = numbers
    controller = PIDIFB().of_person(PROFILE)
    told = observe(glucose, carbs=carbs, bolus=bolus, delivered=delivered, setpoint=setpoint, valid=valid)
    state = controller.init(observe())
    for _ in range(2):
        state, decision = step(controller, state, told)
        assert 0.0 <= float(decision.bolus_mU) <= 25_000.0
        assert 0.0 <= float(decision.insulin_mU_min) <= 66.9
    for leaf in jax.tree.leaves(state):
        assert np.all(np.isfinite(leaf))


@pytest.mark.parametrize(
    ("given", "told"),
    [({"gain": 0.0}, "gain is 0; give a finite number"), ({"integral_time_min": math.inf}, "integral_time_min is inf"),
     ({"derivative_time_min": -1.0}, "derivative_time_min is -1"), ({"carb_ratio_g_U": -1.0}, "carb_ratio_g_U is -1"),
     ({"feedback": -1.0}, "feedback is -1"), ({"meal_bolus": math.nan}, "meal_bolus is nan")],
)  # fmt: skip
def test_impossible_settings_are_refused_with_a_sentence(given, told):
    with pytest.raises(ValueError, match=told):
        PIDIFB(**given).of_person(PROFILE)
