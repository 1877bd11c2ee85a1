"""Rates of meals by the time of day: the table, the prior that it makes, and what an estimator and a controller do."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.build.designs import controller_of
from glucoloop.control import Observation, design_meal_mpc
from glucoloop.estimation.unknown_meal import MealHabits, MovingHorizonSettings, design_meal_horizon, design_meal_kalman
from glucoloop.estimation.unknown_meal.expectation import expectation
from glucoloop.estimation.unknown_meal.habits import daily_rates, earlier, parse_daily
from glucoloop.estimation.unknown_meal.replay import estimate_meals
from glucoloop.situations.situation import configured
from glucoloop.trials.trial import Trial

NIGHT, DAY = 2 * 60.0, 12 * 60.0
TABLE = "0.6@06:30 0.02@22:00"
tables = st.one_of(  # of few sizes, for which few programs are compiled
    st.dictionaries(st.integers(0, 1439), st.sampled_from([0.01, 0.5]), min_size=number, max_size=number)
    for number in (1, 6)
)
step = jax.jit(lambda controller, state, seen: controller.step(state, seen))
value_at = jax.jit(lambda daily, rates, time: daily.at(rates, time))


# ------------------------------------------------------------------------------------------------ the table


def test_a_table_is_values_with_times_or_a_value_for_each_hour():
    assert parse_daily("0.02@22:00   0.6@6:30") == ((390.0, 0.6), (1320.0, 0.02))
    hourly = parse_daily(" ".join(str(0.1 * hour) for hour in range(24)))
    assert hourly == tuple((60.0 * hour, 0.1 * hour) for hour in range(24))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (" ", "there is no value for any time of day; write values and times, like '0.6@06:30 0.02@22:00', or 24"),
        ("often", "'often' is no finite number; write values"),
        ("0.5", "1 number is not one for each hour of the day; write values"),
        (" ".join(["0.5"] * 23), "23 numbers are not one for each hour of the day; write values"),
        ("0.5@06:00 0.7", "'0.7' has no time of day, unlike others; write values"),
        ("nan@06:00", "'nan' is no finite number; write values"),
        ("inf@06:00", "'inf' is no finite number; write values"),
        ("0.5@25:00", "'25:00' is no time of day; write it like 07:30"),
        ("0.5@06:00 0.7@6:00", "the time 6:00 has two values; leave one out"),
        ("0@22:00", "0 meals per hour from 22:00 on are not possible; give a finite value above 0, like 0.01 where"),
        ("0.5@06:00 -1@22:30", "-1 meals per hour from 22:30 on are not possible"),
    ],
)
def test_what_is_no_table_is_refused(text, sentence):
    with pytest.raises(ValueError, match="meals") as told:
        MealHabits(by_time=text)
    assert sentence in str(told.value)


@given(tables, st.floats(0.0, 1439.99))
def test_a_time_of_day_has_the_value_of_the_latest_time_before_it(table, time):
    values = tuple(sorted((float(start), rate) for start, rate in table.items()))
    daily, rates = daily_rates(values, 0.57)
    begun = [rate for start, rate in values if start <= time] or [values[-1][1]]
    assert float(value_at(daily, jnp.asarray(rates), time)) == begun[-1]
    assert rates[0] == 0.57
    for unknown in (None, np.nan, -1.0, 1440.0):
        assert float(value_at(daily, jnp.asarray(rates), unknown)) == 0.57


@given(st.floats(0.0, 1439.9), st.floats(0.0, 5000.0))
def test_an_earlier_time_of_day_is_one(time, minutes):
    then = float(earlier(jnp.asarray(time), minutes))
    assert 0.0 <= then <= 1440.0
    days = (time - then - minutes) / 1440.0
    assert days == pytest.approx(round(days), abs=1e-9)


# -------------------------------------------------------------------------------------------- the estimator


@pytest.fixture(scope="module")
def record(record_of):
    """A person at steady state for an hour, who then eats for an hour and a half, with noise."""
    insulin = np.full(30, 20.0)
    readings = np.append(80.0, record_of(np.repeat([0.0, 1.0], [12, 18]), insulin))[:30]
    return 5.0 * np.arange(30), readings + np.random.default_rng(4).normal(0.0, 0.8, 30), insulin


def found_min(told):
    above = np.asarray(told.eating) > 0.5
    assert above.any()
    return float(told.t_min[above.argmax()])


@pytest.mark.long
def test_a_meal_at_an_unusual_hour_is_found_later_and_at_a_usual_one_as_without_a_table(two_states, record):
    always = estimate_meals(two_states, design_meal_horizon(two_states, MealHabits(0.6, 24.0)), *record)
    by_time = design_meal_horizon(two_states, MealHabits(0.3, 24.0, TABLE))
    day = estimate_meals(two_states, by_time, *record, start_min=DAY)
    night = estimate_meals(two_states, by_time, *record, start_min=NIGHT)
    np.testing.assert_allclose(day.eating, always.eating, rtol=1e-12)
    assert 60.0 < found_min(day) < found_min(night) <= found_min(day) + 30.0
    at_rest = slice(6, 12)
    assert night.eating[at_rest].max() < 0.1 * day.eating[at_rest].mean()


@pytest.mark.long
def test_the_hour_counts_at_the_moment_of_which_a_late_reading_speaks(two_states, record):
    by_time = design_meal_horizon(two_states, MealHabits(0.3, 24.0, "0.6@06:30 0.02@12:00"))
    late = estimate_meals(two_states, by_time, *record, start_min=DAY, dead_time_samples=1)
    prompt = estimate_meals(two_states, by_time, *record, start_min=DAY - 5.0)
    np.testing.assert_allclose(late.eating, prompt.eating, rtol=1e-9)


@pytest.mark.long
def test_without_a_clock_the_rate_is_that_of_all_hours(two_states, record):
    table = estimate_meals(two_states, design_meal_horizon(two_states, MealHabits(0.3, 24.0, TABLE)), *record)
    plain = estimate_meals(two_states, design_meal_horizon(two_states, MealHabits(0.3, 24.0)), *record)
    np.testing.assert_allclose(table.eating, plain.eating, rtol=1e-12)


def test_a_start_that_is_no_time_of_day_is_refused(two_states, record):
    with pytest.raises(ValueError, match="a time of day of 1440 min after midnight is not possible"):
        estimate_meals(two_states, design_meal_kalman(two_states), *record, start_min=1440.0)


@pytest.mark.long
def test_what_is_always_expected_is_that_of_the_hour(two_states):
    by_time = design_meal_horizon(two_states, MealHabits(0.3, 24.0, TABLE), horizon=3)
    expected = expectation(by_time, two_states)
    for rate, time in ((0.3, None), (0.02, jnp.asarray(NIGHT)), (0.6, jnp.asarray(DAY))):
        plain = expectation(design_meal_horizon(two_states, MealHabits(rate, 24.0), horizon=3), two_states)
        here = expected.daily.at(dataclasses.replace(expected, daily=None), time)
        for one, other in zip(jax.tree.leaves(here), jax.tree.leaves(plain), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
        assert float(plain.eating[0]) > 0.0


# ------------------------------------------------------------------------------------------- the controller


@pytest.mark.long
@pytest.mark.parametrize(("time", "rate"), [(NIGHT, 0.02), (DAY, 0.6), (np.nan, 0.3)])
def test_at_any_hour_it_doses_as_if_the_rate_of_that_hour_were_that_of_all(two_states, time, rate):
    readings = 80.0 + np.cumsum(np.random.default_rng(6).normal(0.3, 1.0, 20))

    def doses(controller):
        state, rates = controller.init(observe(80.0, 20.0)), [20.0]
        for reading in readings:
            state, decision = step(controller, state, observe(reading, rates[-1]))
            rates.append(float(decision.insulin_mU_min))
        return rates

    def observe(reading, delivered):
        return Observation(
            glucose_mg_dl=jnp.asarray(reading),
            valid=jnp.asarray(True),
            setpoint_mg_dl=jnp.asarray(80.0),
            delivered_mU_min=jnp.asarray(delivered),
            announced_carbs_g=jnp.zeros(()),
            time_of_day_min=jnp.asarray(time),
        )

    by_time, same = (
        design_meal_mpc(two_states, habits=habits, estimator=MovingHorizonSettings(horizon=3))
        for habits in (MealHabits(0.3, 24.0, TABLE), MealHabits(rate, 24.0))
    )
    assert by_time.needs_time_of_day
    assert not same.needs_time_of_day
    np.testing.assert_allclose(doses(by_time), doses(same), rtol=1e-9)


@pytest.mark.long
def test_a_table_needs_a_clock():
    keys = {"controller": {"name": "meal-mpc", "meals_by_time": TABLE}}
    trial = configured(Trial, keys)
    with pytest.raises(
        ValueError, match=r"is to go by the time of day, .* give the time at the start, like --start 06:00"
    ):
        controller_of(trial, trial.cases[0])
    told = configured(Trial, keys, start="22:00")
    assert controller_of(told, told.cases[0]).needs_time_of_day
