"""A meal model of another package: one class, and every command knows it."""

import pytest

from glucoloop.meals import HovorkaGut, Scenario
from glucoloop.meals.models import MEAL_MODELS
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured

NAME = "your_own_meal_model:AfterFat"


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_meal_model", "meal_models", "after-fat", "AfterFat")
    return tmp_path


def test_it_is_found_by_its_entry_point_and_by_its_place(outside):
    assert "after-fat" in MEAL_MODELS.names()
    assert MEAL_MODELS.find("after-fat") == MEAL_MODELS.find(NAME)


@pytest.mark.parametrize("name", ["after-fat", NAME])
def test_it_digests_the_meals_of_runs_and_scenarios_with_its_settings(outside, name):
    slow = HovorkaGut(time_to_maximum_min=61.0)
    assert configured(Run, meal_model=f"{name}, fat_g=30").as_scenario().meal_model == slow
    assert Scenario(meal_model=f"{name}, fat_g=30").meal_model == slow


def test_a_run_keeps_all_its_settings(outside):
    tree = configured(Run, meal_model=NAME).tree(whole=True)
    assert tree["meal_model"] == {"name": NAME, "fat_g": 20.0}
    assert configured(Run, **{"meal_model": tree["meal_model"]}).gut == HovorkaGut(time_to_maximum_min=54.0)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("soup", "unknown meal model 'soup'; the known ones are: lehmann-deutsch, hovorka"),
        (f"{NAME}, fat_g=-1", "fat_g is -1 g; give a number from 0 to 200 g"),
        ("hovorka, bioavailability=2", "bioavailability is 2; give a number above 0 and up to 1"),
        ("hovorka, fat_g=1", "the meal model hovorka has no setting 'fat_g'"),
    ],
)
def test_what_it_cannot_be_is_said(outside, text, sentence):
    with pytest.raises(ValueError, match=sentence):
        configured(Run, meal_model=text)
