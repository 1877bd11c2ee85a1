"""Scenarios: what they bring, what is given beside them, and files of one's own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.situations.scenarios import SCENARIOS
from glucoloop.situations.situation import configured
from glucoloop.studies.hil import Hil
from glucoloop.trials.trial import Trial

NAMES = [name for name in SCENARIOS if name != "custom"]
OF_SCENARIO = (
    *("days", "duration_min", "meal_size_spread_pct", "meal_time_spread_min", "habits", "announce_meals"),
    *("carb_error_pct", "carb_bias_pct", "start", "warm_up_min"),
    *("profile_error", "rhythm", "actions", "events"),
)


@pytest.mark.parametrize("root", [Run, Trial])
@pytest.mark.parametrize("name", NAMES)
def test_a_scenario_is_what_it_says_in_every_command(root, name):
    asked = configured(root, scenario=name, patient="hovorka-2004")
    for key in OF_SCENARIO:
        assert getattr(asked, key) == getattr(SCENARIOS[name](), key), key
    assert asked.plan.horizon_min == {"week": 10_080.0, "year": 524_160.0}.get(name, 1440.0)
    again = configured(root, asked.tree())
    assert again.drawn_days([0]).eaten.carbs_g.tolist() == asked.drawn_days([0]).eaten.carbs_g.tolist()


def test_what_is_given_beside_a_scenario_counts():
    run = configured(Run, scenario="week", days=2, habits=[], meals=["30g@8h"], carb_error_pct=5.0)
    assert (run.days, run.habits, run.carb_error_pct) == (2, (), 5.0)
    assert run.announce_meals
    assert configured(Run, scenario="week, days=3, carb_error=10").days == 3
    short = configured(Run, scenario="week", duration_min=1500.0)
    assert (short.days, short.horizon_min) == (None, 1500.0)


def test_a_day_that_is_unkind_is_so_to_everybody():
    days = configured(Trial, scenario="unkind-day").drawn_days(np.arange(50))
    assert (days.carbs_g > 0.0).all()
    snack = days.which > 3
    assert days.t_min[snack].tolist() == [[930.0] * 50]
    assert not days.announced_g[snack].any()
    late = days.announced_min - days.t_min
    assert sorted(np.unique(late).tolist()) == [0.0, 20.0]


def test_a_week_varies_between_people_and_days():
    days = configured(Trial, scenario="week").drawn_days(np.arange(400))
    planned = days.which < 3
    weekend = planned & (days.day >= 5)
    eaten = days.carbs_g > 0.0
    assert days.carbs_g[weekend][eaten[weekend]].mean() > 1.15 * days.carbs_g[planned & ~weekend].mean()
    assert (days.announced_g[planned] == 0.0).mean() == pytest.approx(1.0 - 0.9 * 0.97, abs=0.02)
    assert eaten[~planned].mean() == pytest.approx(0.4 * 0.97, abs=0.03)


def test_a_file_has_the_keys_of_a_configuration(tmp_path):
    file = tmp_path / "days.toml"
    file.write_text(
        'meals = ["50g@8h"]\ndays = 3\nhabits = ["skipped, probability=0.5", {name = "snack", time = "15h"}]\n'
    )
    run = configured(Run, scenario=str(file))
    assert (run.days, run.meals) == (3, ("50g@480min",))
    assert [habit.name for habit in run.habits] == ["skipped", "snack"]
    assert run.habits[1].time_min == 900.0
    # what was read stays with the run, without the file
    file.unlink()
    assert configured(Run, run.tree()).habits == run.habits


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("meal = 3", "no setting 'meal'"),
        ("days = 400", "give a whole number from 1 to 366"),
        ("habits = ['snak']", "did you mean 'snack'"),
        ("days = [", "is not TOML"),
        ("meals = ['50x']", "is not a meal"),
        ("days = 2\nduration = 60", "leave one out"),
        ("patient = 'hovorka-2004'", "no setting 'patient'"),
    ],
)
def test_a_file_that_is_no_scenario_is_refused_with_its_name(tmp_path, text, says):
    file = tmp_path / "days.toml"
    file.write_text(text)
    with pytest.raises(Refusal, match=says):
        configured(Run, scenario=str(file))


@pytest.mark.parametrize("name", ["wek", "nothing.toml", "a\0b.toml"])
def test_what_is_no_scenario_is_refused(name):
    with pytest.raises(Refusal, match=r"week|cannot be read|NUL"):
        configured(Run, scenario=name)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 366), st.floats(0.0, 60.0), st.sampled_from(NAMES))
def test_days_that_are_given_count_for_any_scenario(days, spread, name):
    trial = configured(Trial, patient="hovorka-2004", scenario=f"{name}, days={days}", meal_time_spread_min=spread)
    assert trial.plan.horizon_min == 1440.0 * days
    assert trial.meal_time_spread_min == spread


def test_what_a_command_cannot_do_is_refused_in_a_scenario_too():
    assert configured(Hil, scenario="plain-day").announce_meals
    with pytest.raises(Refusal, match="warm_up_min, which is no part of a run on a chip"):
        configured(Hil, scenario="plain-day, warm_up=1d")
