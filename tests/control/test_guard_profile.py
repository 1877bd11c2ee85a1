"""What a guard knows of a person and of a meal: limits by the person's profile, and the bolus of an announced meal."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import BasalBolus, GuardSettings, Status, guarded
from glucoloop.pumps import bolus_limits
from glucoloop.therapy import Profile
from guarding import BASAL, SETPOINT, Wants, follow, observe, step

SKIN = GuardSettings.for_route("subcutaneous")
PERSON = Profile(basal_mU_min=BASAL, setpoint_mg_dl=SETPOINT)
DAILY_U = 48.0 * 60.0 * BASAL / 1000.0
RATIO_G_U, FACTOR_MG_DL_U = 500.0 / DAILY_U, 1800.0 / DAILY_U
"""Ratio and factor of the rules, for a total daily dose of 48 basal hours."""
HIGH = SETPOINT + np.minimum(4.0 * np.arange(40), 90.0) + 0.1 * (np.arange(40) % 2)


def of_person(guard, **known):
    return guard.with_profile(Profile(basal_mU_min=BASAL, setpoint_mg_dl=SETPOINT, **known))


def seen(glucose, carbs=0.0):
    return dataclasses.replace(observe(glucose, carbs=carbs), delivered_bolus_mU=jnp.zeros(()))


def largest_bolus(settings=SKIN, **known):
    """Bolus, in basal hours, for a meal for which far more is asked than is allowed."""
    asks = BasalBolus(carb_ratio_g_U=1.0).of_person(PERSON, bolus=bolus_limits(max_U=90.0))
    guard = of_person(guarded(asks, settings), **known)
    decision = step(guard, guard.init(seen(SETPOINT)), seen(SETPOINT, carbs=500.0))[1]
    assert int(decision.status) == Status.DOSE_LIMITED
    return float(decision.bolus_mU) / (60.0 * BASAL)


def test_who_needs_more_insulin_for_a_meal_may_have_more_of_it_and_who_needs_less_less():
    usual = largest_bolus()
    assert usual == pytest.approx(10.0, rel=0.03)
    assert largest_bolus(carb_ratio_g_U=RATIO_G_U) == pytest.approx(usual)
    assert largest_bolus(carb_ratio_g_U=RATIO_G_U / 2.0) == pytest.approx(2.0 * usual)
    assert largest_bolus(carb_ratio_g_U=RATIO_G_U * 1.6) == pytest.approx(usual / 1.6)


def test_a_profile_changes_the_limits_up_to_a_factor_and_not_where_it_is_unknown():
    usual = largest_bolus()
    assert largest_bolus(carb_ratio_g_U=RATIO_G_U / 50.0) == pytest.approx(3.0 * usual)
    assert largest_bolus(carb_ratio_g_U=RATIO_G_U * 50.0) == pytest.approx(usual / 3.0)
    assert largest_bolus(carb_ratio_g_U=float("nan")) == usual
    vein = GuardSettings(max_hour=11.0, max_on_board=5.0)
    assert largest_bolus(vein, carb_ratio_g_U=RATIO_G_U / 2.0) == largest_bolus(vein)


def test_who_needs_less_basal_insulin_than_others_of_that_weight_may_have_a_bolus_by_the_own_ratio():
    usual, ratio = largest_bolus(), RATIO_G_U / 5.0
    of_daily = DAILY_U / 0.5
    assert largest_bolus(carb_ratio_g_U=ratio, weight_kg=of_daily) == pytest.approx(3.0 * usual)
    assert largest_bolus(carb_ratio_g_U=ratio, weight_kg=0.1 * of_daily) == pytest.approx(3.0 * usual)
    assert largest_bolus(carb_ratio_g_U=ratio, weight_kg=float("nan")) == pytest.approx(3.0 * usual)
    assert largest_bolus(carb_ratio_g_U=ratio, weight_kg=2.0 * of_daily) == pytest.approx(5.0 * usual)
    assert largest_bolus(carb_ratio_g_U=RATIO_G_U / 50.0, weight_kg=2.0 * of_daily) == pytest.approx(6.0 * usual)
    assert largest_bolus(carb_ratio_g_U=RATIO_G_U * 50.0, weight_kg=2.0 * of_daily) == pytest.approx(usual / 3.0)
    vein = GuardSettings(max_hour=11.0, max_on_board=5.0)
    assert largest_bolus(vein, carb_ratio_g_U=ratio, weight_kg=2.0 * of_daily) == largest_bolus(vein)


def test_the_insulin_that_a_reading_allows_follows_the_factor_with_a_margin():
    guard = guarded(Wants(rate=66.9), SKIN)
    plain = follow(of_person(guard), HIGH)[0]
    as_usual = follow(of_person(guard, correction_mg_dl_U=FACTOR_MG_DL_U / 1.4), HIGH)[0]
    np.testing.assert_allclose(as_usual, plain, rtol=1e-12)
    np.testing.assert_array_equal(follow(of_person(guard, correction_mg_dl_U=float("nan")), HIGH)[0], plain)
    resistant = follow(of_person(guard, correction_mg_dl_U=FACTOR_MG_DL_U / 3.0), HIGH)[0]
    sensitive = follow(of_person(guard, correction_mg_dl_U=FACTOR_MG_DL_U), HIGH)[0]
    assert sensitive.sum() < plain.sum() < resistant.sum()


def test_an_announced_meal_gets_its_bolus_though_a_low_is_predicted_but_not_where_the_reading_is_low():
    guard = guarded(BasalBolus(carb_ratio_g_U=10.0).of_person(PERSON), SKIN)
    state = guard.init(seen(SETPOINT + 20.0))
    for glucose in (99.0, 95.0, 89.0):
        state = step(guard, state, seen(glucose))[0]
    falling, meal = step(guard, state, seen(82.0, carbs=40.0))
    assert int(meal.status) == Status.SUSPENDED
    assert float(meal.insulin_mU_min) < BASAL
    assert float(meal.bolus_mU) > 3000.0
    low = step(guard, falling, seen(64.0, carbs=40.0))[1]
    assert float(low.bolus_mU) == 0.0
