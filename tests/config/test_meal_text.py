"""Meals as text."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.config import meal_text, parse_meal
from glucoloop.meals import Meal

grams = st.floats(min_value=0.0, max_value=1000.0, exclude_min=True)
minutes = st.floats(min_value=0.0, max_value=1e300)


@given(grams, minutes)
def test_a_meal_comes_back_to_the_last_bit(carbs_g, t_min):
    meal = Meal(carbs_g, t_min)
    assert parse_meal(meal_text(meal)) == meal


@given(st.text())
def test_any_text_is_a_meal_or_refused(text):
    with contextlib.suppress(ValueError):
        meal = parse_meal(text)
        assert parse_meal(meal_text(meal)) == meal


@pytest.mark.parametrize("text", ["50g@50min", "50@50", "50g@50m", " 50 g @ 50 min ", "5e1@.5e2", "+50.0g@50."])
def test_ways_to_write_a_meal(text):
    assert parse_meal(text) == Meal(50.0, 50.0)


def test_hours():
    assert parse_meal("50g@1.5h") == Meal(50.0, 90.0)


@pytest.mark.parametrize("text", ["", "50", "@50", "50@", "50g", "50@50s", "50kg@50", "50@50@50", "nan@50", "5 0@50"])
def test_what_is_no_meal(text):
    with pytest.raises(ValueError, match="is not a meal; write grams and a time, like 50g@50min"):
        parse_meal(text)
