"""Meals as text."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.meals import Meal
from glucoloop.situations.meal_text import meal_text, parse_meal

grams = st.floats(min_value=0.0, max_value=1000.0, exclude_min=True)
minutes = st.floats(min_value=0.0, max_value=1e300)
eating = st.one_of(st.just(0.0), st.floats(min_value=1.0, max_value=1440.0))


@given(grams, minutes, eating)
def test_a_meal_comes_back_to_the_last_bit(carbs_g, t_min, eating_min):
    meal = Meal(carbs_g, t_min, eating_min)
    assert parse_meal(meal_text(meal)) == meal


@pytest.mark.long
@given(st.text())
def test_any_text_is_a_meal_or_refused(text):
    with contextlib.suppress(ValueError):
        meal = parse_meal(text)
        assert parse_meal(meal_text(meal)) == meal


@pytest.mark.parametrize("text", ["50g@50min", "50@50", "50g@50m", " 50 g @ 50 min ", "5e1@.5e2", "+50.0g@50."])
def test_ways_to_write_a_meal(text):
    assert parse_meal(text) == Meal(50.0, 50.0)


def test_hours_and_days():
    assert parse_meal("50g@1.5h") == Meal(50.0, 90.0)
    assert parse_meal("50g@1.5d") == Meal(50.0, 2160.0)


@pytest.mark.parametrize("text", ["50g@50min/15min", "50@50/15", "50g@50m/.25h", " 50 g @ 50 min / 15 m "])
def test_eating_takes_time(text):
    assert parse_meal(text) == Meal(50.0, 50.0, 15.0)


def test_a_meal_that_is_eaten_at_once_is_written_without_a_slash():
    assert meal_text(Meal(50.0, 60.0)) == "50g@60min"
    assert meal_text(Meal(50.0, 60.0, 15.0)) == "50g@60min/15min"
    assert parse_meal("50g@60min/0") == Meal(50.0, 60.0)


def test_a_time_of_eating_that_is_not_possible_is_refused():
    with pytest.raises(ValueError, match="a meal eaten over 2000 min is not possible; give 0"):
        parse_meal("50g@50min/2000min")


@pytest.mark.parametrize("text", ["50g@50min/", "50@50/15/15", "50@50/15s", "50/15@50", "50@/15"])
def test_what_is_no_time_of_eating(text):
    with pytest.raises(ValueError, match="and after a slash how long eating takes, like 50g@50min/15min"):
        parse_meal(text)


@pytest.mark.parametrize("text", ["", "50", "@50", "50@", "50g", "50@50s", "50kg@50", "50@50@50", "nan@50", "5 0@50"])
def test_what_is_no_meal(text):
    with pytest.raises(ValueError, match="is not a meal; write grams and a time, like 50g@50min"):
        parse_meal(text)
