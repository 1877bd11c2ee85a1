"""Carbohydrate as it is counted: whose error it is, how large, and what reaches the controller of it."""

import numpy as np
import pytest

from glucoloop.meals import Meal
from glucoloop.meals.plan import MealPlan, draw_days
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.trials.trial import Trial
from glucoloop.units import parse_time_of_day

PEOPLE = np.arange(4000)


def counted(carbs_g, person=PEOPLE, seed=7, *, error_pct=30.0, bias_pct=0.0, days=1):
    plan = MealPlan([Meal(size, 60.0 + 300.0 * place) for place, size in enumerate(carbs_g)], days)
    return draw_days(plan, seed, person).counted(error_pct, bias_pct).announced_g


def test_the_error_has_the_mean_and_the_deviation_that_are_asked_for():
    told = counted([50.0, 80.0], bias_pct=-10.0) / np.array([[50.0], [80.0]])
    np.testing.assert_allclose(told.mean(axis=1), 0.9, atol=4 * 0.3 / np.sqrt(4000))
    np.testing.assert_allclose(told.std(axis=1), 0.3, atol=0.015)
    assert abs(np.corrcoef(told)[0, 1]) < 0.06  # each meal has an error of its own


def test_a_person_counts_the_same_whoever_else_is_drawn_and_however_many_days_follow():
    some, days = counted([50.0, 60.0, 70.0], [17, 3]), counted([50.0, 60.0, 70.0], days=2)
    np.testing.assert_array_equal(some, days[:3, [17, 3]])
    assert not np.array_equal(days[:3], days[3:])
    assert not np.array_equal(some, counted([50.0, 60.0, 70.0], [17, 3], seed=8))


def test_who_eats_nothing_counts_nothing():
    run = configured(Run, meals=[], announce_meals=True, carb_error_pct=30.0)
    assert run.as_scenario().meals == ()


def test_nothing_impossible_is_announced():
    told = counted([900.0, 5.0], error_pct=100.0)
    assert told.min() == 0.0
    assert told.max() == 1000.0


def test_a_bias_alone_is_exact():
    np.testing.assert_allclose(counted([50.0], error_pct=0.0, bias_pct=20.0), 60.0, rtol=1e-14)


def test_a_run_counts_as_person_0_of_a_trial_of_its_seed():
    run = configured(Run, meals=["70g@360", "50g@50"], seed=7, announce_meals=True, carb_error_pct=30.0)
    told = [meal.announced_g for meal in run.eaten()]
    np.testing.assert_array_equal(told, counted([50.0, 70.0], [0])[:, 0])
    assert [meal.carbs_g for meal in run.eaten()] == [50.0, 70.0]


KEYS = {"announce_meals": True, "carb_error_pct": 30.0, "carb_bias_pct": -5.0, "start": "07:30"}


def test_a_run_and_a_trial_are_read_again_from_their_own_keys():
    run = configured(Run, KEYS)
    assert run.as_scenario().start_min == 450.0
    assert run.miscounts
    assert configured(Run, run.tree()) == run
    trial = configured(Trial, KEYS, people=3)
    assert (trial.carb_error_pct, trial.carb_bias_pct, trial.start_min) == (30.0, -5.0, 450.0)
    assert configured(Trial, trial.tree()).start_min == 450.0


@pytest.mark.parametrize("root", [Run, Trial])
def test_an_error_of_what_is_not_announced_is_refused(root):
    with pytest.raises(ValueError, match="announce the meals"):
        configured(root, carb_error_pct=30.0)


@pytest.mark.parametrize("text", ["24:00", "7", "07:60", "7.30", "", "-1:00", "٠٧:٣٠"])
def test_what_is_no_time_of_day_is_refused(text):
    with pytest.raises(ValueError, match="no time of day"):
        parse_time_of_day(text)


def test_a_time_of_day_is_read_and_written():
    assert parse_time_of_day(" 7:05 ") == 425.0
    assert parse_time_of_day("23:59") == 1439.0
