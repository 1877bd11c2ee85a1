"""Estimators of unknown meals on trial: scores by hand, days that are what they say, and a true meal found."""

import dataclasses

import numpy as np
import pytest

from glucoloop.meals import Eaten, draw_meals
from glucoloop.situations.situation import configured
from glucoloop.studies.detection import Detection
from glucoloop.studies.detection.evaluate import (
    _days_of,
    _delays_min,
    _estimate_at,
    _false_alarms,
    _followed_min,
    _in_order,
    _under_way,
    _who_and_when,
    evaluate,
)
from glucoloop.studies.detection.study import _results

# Scores, by hand ------------------------------------------------------------------------------------------------------

T_MIN = 5.0 * np.arange(60)
END = 300.0
NAN = np.nan


def day(**above):
    """Probability of 0.1, and 0.9 at the samples named by their times: ``day(at=[35.0])``."""
    return np.where(np.isin(T_MIN, above["at"]), 0.9, 0.1)


def meals(*days):
    """Of each day, beginnings and sizes."""
    begin, carbs = (np.array([[meal[part] for meal in of_day] for of_day in days], float).T for part in (0, 1))
    return Eaten(t_min=begin, carbs_g=carbs, eating_min=np.zeros_like(begin))


def test_a_delay_ends_at_the_first_sample_above_the_threshold():
    # 36 g are served in 100 min, so each meal is under way for 160 min
    eating = np.stack(
        [
            day(at=[30.0, 40.0, 45.0]),  # a false alarm, and then the meal
            day(at=[35.0]),  # above it already, and not found again
            day(at=[35.0, 60.0]),
            day(at=[200.0, 205.0]),  # too late: the meal was over at 197 min
            day(at=[190.0]),
            day(at=[]),
        ],
        axis=1,
    )
    delay, already = _delays_min(eating, T_MIN, meals(*[[(37.0, 36.0)]] * 6), 0.5, END)
    np.testing.assert_array_equal(delay, [[3.0, NAN, NAN, NAN, 153.0, NAN]])
    assert already.tolist() == [[False, True, True, False, False, False]]
    # a higher threshold than all finds nothing; what equals it is not above it
    assert np.isnan(_delays_min(eating, T_MIN, meals(*[[(37.0, 36.0)]] * 6), 0.9, END)[0]).all()


def test_a_meal_is_not_found_by_the_next_one():
    eating = day(at=[70.0, 75.0])[:, None]
    delay, already = _delays_min(eating, T_MIN, meals([(10.0, 36.0), (62.0, 36.0)]), 0.5, END)
    np.testing.assert_array_equal(delay, [[NAN], [8.0]])
    assert not already.any()


def test_false_alarms_are_rises_while_no_meal_is_under_way():
    eaten = meals([(50.0, 18.0)])  # served until 100 min, under way until 160 min
    quiet = ~_under_way(eaten, T_MIN)
    assert T_MIN[~quiet[:, 0]].tolist() == [*range(50, 161, 5)]
    eating = day(at=[0.0, 10.0, 15.0, 45.0, 50.0, 80.0, 160.0, 165.0, 200.0, 210.0])[:, None]
    # at 0, 10, 45 (which lasts into the meal), 200 and 210 min; what rose at 160 min did so under way
    assert _false_alarms(eating, quiet, 0.5) == 5
    assert _false_alarms(eating, np.ones_like(quiet), 0.5) == 7
    assert _days_of(quiet, 5.0) == pytest.approx((60 - 23) * 5.0 / 1440.0)


def test_what_is_told_of_a_meal_is_told_in_its_time():
    values = np.arange(60.0)[:, None]
    eaten = meals([(12.0, 3.6), (62.0, 3.6), (230.0, 3.6)])
    over = _followed_min(eaten, END)
    assert over.ravel().tolist() == [62.0, 230.0, 300.0]

    def told(after, since):
        return _estimate_at(values, T_MIN, eaten.t_min + after, eaten.t_min + since, over).ravel()

    np.testing.assert_array_equal(told(30.0, 10.0), [9.0, 19.0, 52.0])  # at 45, 95 and 260 min
    np.testing.assert_array_equal(told(48.0, 10.0), [12.0, 22.0, 56.0])  # at 60, 110 and 280 min
    np.testing.assert_array_equal(told(60.0, 10.0), [NAN, 25.0, 58.0])  # the second has begun
    np.testing.assert_array_equal(told(70.0, 10.0), [NAN, 27.0, NAN])  # the day is over
    np.testing.assert_array_equal(told(30.0, 34.0), [NAN, NAN, NAN])  # not yet detected
    np.testing.assert_array_equal(told(30.0, NAN), [NAN, NAN, NAN])  # never


def test_meals_of_a_day_are_put_in_order():
    begin, carbs = np.array([[90.0, 20.0], [30.0, 40.0]]), np.array([[9.0, 2.0], [3.0, 4.0]])
    ordered = _in_order(Eaten(t_min=begin, carbs_g=carbs, eating_min=carbs))
    assert ordered.eating_min.tolist() == ordered.carbs_g.tolist()
    assert ordered.t_min.tolist() == [[30.0, 20.0], [90.0, 40.0]]
    assert ordered.carbs_g.tolist() == [[3.0, 2.0], [9.0, 4.0]]


# The nominal person, free of noise ------------------------------------------------------------------------------------


# nobody's gut is another than the model's, and without noise nothing else tells so
SLOW_GUTS = "moving-horizon, fast_meals=0"


def days_judged_by(estimator):
    rare = {"name": "meal-mpc", "meals_per_h": 0.05, "disturbance_variance": 0.1}
    return configured(Detection, days=3, sensor=[], controller="basal", estimators=[estimator], estimates_by=rare)


@pytest.fixture(scope="module")
def asked():
    return days_judged_by(SLOW_GUTS)


@pytest.fixture(scope="module")
def result(asked):
    return evaluate(asked, lambda done: None)


@pytest.mark.long
def test_true_meals_are_all_found_and_sized(result):
    (of,) = result.by_estimator.values()
    assert of.tables["meals"].height == 6
    assert not of.tables["meals"]["missed"].any()
    assert not of.tables["meals"]["already"].any()
    # a sample later than by whoever is told that the sensor has no error
    assert of.tables["meals"]["delay_min"].max() < 30.0
    # each begins and ends within a sample, of which there is no telling where
    np.testing.assert_allclose(of.tables["meals"]["estimated_g"], of.tables["meals"]["carbs_g"], atol=2.0 * 1.8)
    at = of.tables["curve"].filter(threshold=0.5)
    assert at["false_alarms_fasting_per_day"].item() == 0.0
    assert at["false_alarms_between_per_day"].item() == 0.0
    assert (of.tables["curve"]["missed_pct"].diff().drop_nulls() >= 0.0).all()
    assert of.alarms["fasting_days"] == pytest.approx(3.0)
    # what is expected of a meal comes to be what it is
    assert abs(of.tables["size_error"]["error_p50_g"][-1]) < 1.8


@pytest.mark.long
def test_who_is_told_that_the_sensor_has_no_error_finds_meals_sooner():
    (of,) = evaluate(days_judged_by(f"{SLOW_GUTS}, noise_drift=0"), lambda done: None).by_estimator.values()
    assert of.tables["meals"]["delay_min"].max() < 25.0


@pytest.mark.long
def test_meals_are_those_of_the_plan(asked, result):
    (of,) = result.by_estimator.values()
    drawn = draw_meals(asked.all_days, asked.seed, [0])
    np.testing.assert_allclose(of.tables["meals"]["carbs_g"], drawn.carbs_g[:, 0])
    np.testing.assert_allclose(of.tables["meals"]["t_min"] + 1440.0 * of.tables["meals"]["day"], drawn.t_min[:, 0])
    assert of.tables["meals"]["day"].to_list() == [0, 0, 1, 1, 2, 2]
    assert len(set((of.tables["meals"]["t_min"] % 5.0).round(6))) == 6  # off the grid of samples


@pytest.mark.long
def test_the_example_is_the_first_day(result):
    (of,) = result.by_estimator.values()
    held = of.tables["day"]
    np.testing.assert_allclose(held["insulin_mU_min"], held["insulin_mU_min"][0])
    np.testing.assert_array_equal(held["glucose_mg_dl"], held["reading_mg_dl"])  # no noise
    eaten = of.tables["meals"].filter(day=0)["carbs_g"].sum()
    assert 5.0 * held["emptying_mg_min"].sum() / 1000.0 == pytest.approx(eaten, rel=0.01)
    assert 5.0 * held["estimated_emptying_mg_min"].sum() / 1000.0 == pytest.approx(eaten, rel=0.08)


@pytest.mark.long
def test_numbers_of_the_summary_are_those_of_the_meals(asked, result):
    meals = result.by_estimator[SLOW_GUTS].tables["meals"].to_numpy(structured=True)
    summary = _results(asked, result).plain["estimators"][SLOW_GUTS]
    assert summary["meals"] == 6 == sum(size["meals"] for size in summary["by_size"])
    assert summary["delay_median_min"] == pytest.approx(np.median(meals["delay_min"]))
    error = meals["estimated_g"] - meals["carbs_g"]
    assert summary["size_error_after_end_mean_absolute_g"] == pytest.approx(np.abs(error).mean())
    assert summary["missed_pct"] == 0.0
    at_30 = meals["expected_30_min_g"] - meals["carbs_g"]
    assert summary["size_error_at_30_min_median_g"] == pytest.approx(np.median(at_30))
    assert summary["size_error_at_30_min_p90_g"] == pytest.approx(np.quantile(at_30, 0.9))
    for size in summary["by_size"]:
        within = (meals["carbs_g"] >= size["from_g"]) & (meals["carbs_g"] < (size["to_g"] or np.inf))
        assert size["meals"] == within.sum()


@pytest.mark.long
def test_without_meals_there_is_no_number_of_them():
    asked = configured(Detection, days=1, meals=[], meal_size_spread_pct=0.0, controller="basal", estimators=["kalman"])
    summary = _results(asked, evaluate(asked, lambda done: None)).plain["estimators"]["kalman"]
    assert (summary["meals"], summary["delay_median_min"], summary["missed_pct"]) == (0, None, None)
    assert summary["false_alarms_between_per_day"] is None
    assert summary["false_alarms_fasting_per_day"] >= 0.0


# What is asked for ----------------------------------------------------------------------------------------------------


def test_a_test_is_read_again_from_its_tree(asked):
    for detection in (asked, configured(Detection), configured(Detection, people=7, population="parker2000")):
        again = configured(Detection, detection.tree())
        assert again.tree(whole=True) == detection.tree(whole=True)


@pytest.mark.long
def test_usual_days_are_a_hundred_of_one_person_or_one_of_many():
    one, many = configured(Detection), configured(Detection, people=30, population="parker2000", seed=3)
    assert (one.people, one.number_of_days, list(one.tried)) == (1, 100, ["moving-horizon", "kalman"])
    assert (many.people, many.number_of_days) == (30, 1)
    assert [case.tuning["estimator"].name for case in one.trial.cases] == list(one.tried)
    twice = dataclasses.replace(many, days=2)
    person, day_of, infeasible = _who_and_when(twice)
    assert day_of.tolist() == [0, 1] * (person.size // 2)
    assert person.size // 2 + infeasible == 30


def test_settings_of_the_estimator_are_not_the_controllers():
    asked = configured(
        Detection, controller="mpc-se, move_weight=2", estimates_by={"name": "meal-mpc", "measurement_variance": 3.0}
    )
    (case,) = asked.trial.cases
    assert asked.estimating.measurement_variance == 3.0
    assert case.tuning["measurement_variance"] == 1.45
    assert case.tuning["move_weight"] == 2.0
    assert case.label == "mpc-se, move_weight=2"


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"estimators": []}, "--estimator names none; give one or more of moving-horizon, kalman"),
        ({"estimators": ["kalmen"]}, "unknown estimator 'kalmen'; did you mean 'kalman'?"),
        ({"estimators": ["kalman", "kalman"]}, "--estimator is kalman, one of them twice; leave one out"),
        ({"threshold": 0.0}, "threshold is 0; give a number above 0 and below 1"),
        ({"threshold": 1.0}, "threshold is 1; give a number above 0 and below 1"),
        ({"days": 0}, "days is 0; give"),
        ({"days": 366, "people": 1000}, "366 days of 1000 people are too many; give at most 100000 days in all"),
        ({"controller": "meal-mpc, estimator=kalman"}, "the controller meal-mpc is tried with each of the estimators"),
        (
            {"estimates_by": "meal-mpc, estimator=kalman"},
            "the controller meal-mpc is tried with each of the estimators",
        ),
        ({"announce_meals": False}, "announce_meals is no part of a test of estimators"),
        ({"duration_min": 100.0}, "duration_min is no part of a test of estimators"),
        ({"controller": "mcp"}, "unknown controller 'mcp'"),
        ({"controller": "basal, move_weight=1"}, "the controller basal has no setting 'move_weight'"),
        ({"estimators": [{"name": "moving-horizon", "horizon": 2.5}]}, "horizon is 2.5; give a whole number"),
        ({"estimators": ["kalman, horizon=3"]}, "the estimator kalman has no setting 'horizon'"),
        ({"estimates_by": {"name": "pid"}}, "--estimates-by is pid; give settings of meal-mpc"),
        ({"controller": ["basal", "imc"]}, "there are 2 controllers (basal, imc); give one"),
        ({"sample_time_min": 7.0}, "a horizon of 1440 min is not a whole number of samples of 7 min"),
    ],
)
def test_what_cannot_be_is_refused(keys, sentence):
    with pytest.raises(ValueError, match=r"^.*$") as refused:
        configured(Detection, keys)
    assert sentence in str(refused.value)
