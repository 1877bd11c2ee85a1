"""Rewards: what their papers say of them."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.gym.rewards import REWARDS, kovatchev_risk, magni_risk, reward_of

GLUCOSE = st.floats(-100.0, 2000.0)


def test_the_risk_of_magni_is_25_at_70_and_at_280_and_0_between():
    np.testing.assert_allclose(magni_risk(np.array([70.0, 280.0])), 25.0, atol=0.05)
    lowest = np.exp(3.7932 ** (1.0 / 0.8353))
    np.testing.assert_allclose(lowest, 138.8, atol=0.1)
    np.testing.assert_allclose(magni_risk(lowest), 0.0, atol=1e-9)


def test_the_risk_of_kovatchev_is_100_at_both_ends_of_the_scale():
    np.testing.assert_allclose(kovatchev_risk(np.array([20.0, 600.0])), 100.0, atol=0.7)
    np.testing.assert_allclose(kovatchev_risk(np.array(112.5)), 0.0, atol=1e-4)


def test_changes_of_risk_sum_to_the_change_from_first_to_last():
    course = np.array([[120.0], [250.0], [60.0], [90.0]])
    total = sum(REWARDS["risk-change"].of_step(a, b)[0] for a, b in itertools.pairwise(course))
    np.testing.assert_allclose(total, kovatchev_risk(course[0])[0] - kovatchev_risk(course[-1])[0])


@pytest.mark.parametrize(("glucose", "reward"), [(69.9, 0.0), (70.0, 1.0), (180.0, 1.0), (180.1, 0.0)])
def test_time_in_range_counts_both_ends(glucose, reward):
    assert REWARDS["time-in-range"].of_step(np.array([0.0]), np.array([glucose]))[0] == reward


@given(before=GLUCOSE, after=GLUCOSE)
def test_every_reward_is_a_number_for_any_glucose(before, after):
    for reward in REWARDS.values():
        assert np.isfinite(reward.of_step(np.array([before]), np.array([after]))).all()


def test_ending_early_is_never_worth_it():
    worst_day = 288 * magni_risk(np.array(10.0))
    assert REWARDS["magni-risk"].termination > 0.8 * worst_day
    assert REWARDS["bounded-risk"].each_step_left == 1.0  # no step has less


@given(before=GLUCOSE, after=GLUCOSE)
def test_a_step_of_the_default_reward_is_between_its_bounds_and_has_no_cliff(before, after):
    reward = REWARDS["bounded-risk"].of_step
    values = [reward(np.array([before]), np.array([glucose]))[0] for glucose in (after, after + 0.1)]
    assert all(-1.0 <= value <= 0.0 for value in values)
    assert abs(values[1] - values[0]) < 0.01


def test_a_function_is_a_reward():
    assert reward_of(lambda before, after: after - before).of_step(1.0, 3.0) == 2.0
