"""Habits: what they do to the meals of a day, how often, and that nobody depends on anybody else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.meals import Meal, MealPlan
from glucoloop.meals.habits import HABITS
from glucoloop.meals.plan import draw_days
from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.trials.trial import Trial
from glucoloop.units import MIN_PER_DAY

DAY = (Meal(45.0, 420.0), Meal(70.0, 720.0, 15.0), Meal(60.0, 1080.0))
PEOPLE = np.arange(3000)
ARRAYS = ("t_min", "carbs_g", "eating_min", "announced_g", "announced_min")


def lived(*habits, person=PEOPLE, days=2, seed=5, **plan):
    return draw_days(MealPlan(DAY, days, habits=map(HABITS.choose, habits), **plan), seed, person)


def rows(days):
    """Planned meals and added ones."""
    return days.which < len(DAY), days.which >= len(DAY)


def test_without_habits_a_day_is_the_plan():
    days = lived(person=[3])
    np.testing.assert_array_equal(days.t_min[:, 0], [420, 720, 1080, 1860, 2160, 2520])
    np.testing.assert_array_equal(days.carbs_g[:, 0], [45, 70, 60] * 2)
    np.testing.assert_array_equal(days.eating_min[:, 0], [0, 15, 0] * 2)
    np.testing.assert_array_equal(days.announced_g, days.carbs_g)
    np.testing.assert_array_equal(days.announced_min, days.t_min)


def share(events):
    return pytest.approx(events, abs=4.0 * 0.5 / np.sqrt(6 * PEOPLE.size))


def test_a_skipped_meal_is_neither_eaten_nor_announced():
    days = lived("skipped, probability=0.3")
    skipped = days.carbs_g == 0.0
    assert skipped.mean() == share(0.3)
    np.testing.assert_array_equal(days.announced_g == 0.0, skipped)
    only = lived("skipped, probability=1, meal=2")
    np.testing.assert_array_equal(only.carbs_g[:, 0], [45, 0, 60] * 2)


def test_an_unannounced_meal_is_eaten_all_the_same():
    days = lived("unannounced, probability=0.2")
    assert (days.announced_g == 0.0).mean() == share(0.2)
    np.testing.assert_array_equal(days.carbs_g, lived().carbs_g)


def test_meals_vary_about_their_mean_from_day_to_day():
    days = lived("varied, meal=2, size_sd=40, time_sd=45")
    varied = days.which == 1
    np.testing.assert_array_equal(days.carbs_g[~varied], lived().carbs_g[~varied])
    sizes, times = days.carbs_g[varied], days.t_min[varied] - MIN_PER_DAY * days.day[varied][:, None]
    assert sizes.mean() == pytest.approx(70.0, rel=0.02)
    assert sizes.std() == pytest.approx(28.0, rel=0.05)
    assert np.log(sizes).std() == pytest.approx(np.sqrt(np.log(1.16)), rel=0.03)
    assert (times.mean(), times.std()) == (pytest.approx(720.0, abs=2.0), pytest.approx(45.0, rel=0.03))
    np.testing.assert_array_equal(days.announced_g, days.carbs_g)
    np.testing.assert_array_equal(days.announced_min, days.t_min)


def test_what_is_left_was_announced():
    days = lived("uneaten, probability=0.5, share_pct=40")
    left = days.carbs_g != days.announced_g
    assert left.mean() == share(0.5)
    np.testing.assert_allclose(days.carbs_g[left], 0.6 * days.announced_g[left])


def test_an_announcement_comes_late_or_early_within_its_spread():
    late = lived("announced-late, minutes=20, spread_min=5")
    after = late.announced_min - late.t_min
    assert (after.min(), after.max()) == (pytest.approx(15.0, abs=0.1), pytest.approx(25.0, abs=0.1))
    np.testing.assert_array_equal(late.t_min, lived().t_min)
    early = lived("announced-late, minutes=-15min, meal=1")
    np.testing.assert_array_equal((early.announced_min - early.t_min)[:3, 0], [-15.0, 0.0, 0.0])


def test_a_snack_comes_on_some_days_and_untold():
    days = lived("snack, carbs_g=20, time=21h, probability=0.4, size_spread_pct=50, time_spread_min=30")
    planned, added = rows(days)
    assert (planned.sum(), added.sum()) == (6, 2)
    np.testing.assert_array_equal(days.carbs_g[planned], lived().carbs_g)
    sizes, times = days.carbs_g[added], days.t_min[added] - MIN_PER_DAY * days.day[added][:, None]
    assert (sizes > 0.0).mean() == pytest.approx(0.4, abs=0.03)
    assert 10.0 <= sizes[sizes > 0.0].min() <= sizes.max() <= 30.0
    assert 1230.0 <= times.min() <= times.max() <= 1290.0
    assert not days.announced_g[added].any()
    told = lived("snack, probability=1, announced=true")
    np.testing.assert_array_equal(told.announced_g, told.carbs_g)


def test_a_weekend_is_the_sixth_and_seventh_day_of_a_week():
    days = lived("weekend, size_pct=150, later_min=90", person=[0], days=9)
    weekend = np.isin(days.day, [5, 6])
    np.testing.assert_array_equal(days.carbs_g[weekend, 0], [67.5, 105.0, 90.0] * 2)
    np.testing.assert_array_equal((days.t_min[:, 0] - lived(person=[0], days=9).t_min[:, 0]), 90.0 * weekend)
    np.testing.assert_array_equal(days.announced_min, days.t_min)
    across = lived("weekend, from_day=7, to_day=1, later_min=0", person=[0], days=9)
    np.testing.assert_array_equal(np.unique(across.day[across.carbs_g[:, 0] != lived(days=9).carbs_g[:, 0]]), [0, 6, 7])


ANY_HABITS = st.lists(
    st.sampled_from(
        (
            "skipped, probability=0.3",
            "unannounced, probability=0.5",
            "announced-late, minutes=20, spread_min=10",
            "snack, time=21h, time_spread_min=60",
            "weekend, later_min=-30",
            "uneaten, probability=0.5",
            "varied, size_sd=30, time_sd=20",
        )
    ),
    max_size=5,
)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(ANY_HABITS, st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=4), st.integers(1, 9), st.integers(0, 3))
def test_a_person_lives_the_same_days_whoever_else_is_drawn_and_however_many_follow(habits, people, days, warm_up):
    spreads = {"size_spread_pct": 20.0, "time_spread_min": 30.0, "seed": 11}
    together = lived(*habits, person=people, days=days, warm_up_min=MIN_PER_DAY * warm_up, **spreads)
    alone = lived(*habits, person=people[-1:], days=days + 3, **spreads)

    def of(some, first):
        chosen = (some.day >= 0) & (some.day < days)
        order = np.lexsort((some.which[chosen], some.day[chosen]))
        return [getattr(some, name)[chosen][order, first] for name in ARRAYS]

    for one, other in zip(of(together, -1), of(alone, 0), strict=True):
        np.testing.assert_array_equal(one, other)
    assert (together.carbs_g >= 0.0).all()
    assert (together.announced_g >= 0.0).all()
    assert (together.t_min[together.carbs_g > 0.0] >= -MIN_PER_DAY * warm_up).all()


def test_another_habit_changes_nothing_that_a_habit_draws():
    one = lived("unannounced, probability=0.5")
    other = lived("skipped, probability=0.2, meal=3", "unannounced, probability=0.5")
    np.testing.assert_array_equal(one.announced_g[other.carbs_g > 0.0], other.announced_g[other.carbs_g > 0.0])
    twice = lived("skipped, probability=0.5", "skipped, probability=0.5")
    assert (twice.carbs_g == 0.0).mean() == share(0.75)


def test_part_of_a_day_before_the_start_has_its_meals():
    days = lived(person=[0], warm_up_min=480.0)
    eaten = days.carbs_g[:, 0] > 0.0
    assert days.t_min[eaten, 0].min() == 1080.0 - 1440.0
    assert eaten.sum() == 7
    assert days.first_min() == 420.0


def test_a_run_lives_as_person_0_of_a_trial_of_its_seed():
    keys = {
        "announce_meals": True,
        "meals": ["45g@7h", "70g@12h", "60g@18h"],
        "habits": ["unannounced, probability=0.5", "snack, time=21h, probability=0.5"],
        "days": 5,
        "seed": 3,
    }
    run, trial = configured(Run, keys), configured(Trial, keys, people=4)
    assert run.eaten() == trial.drawn_days([0]).meals_of(0, trial.horizon_min)
    assert len(run.eaten()) > 15
    assert configured(Run, run.tree(whole=True)).eaten() == run.eaten()


def test_a_run_of_days_has_the_meals_of_a_day():
    assert [meal.t_min for meal in configured(Run, days=2).eaten()] == [420, 720, 1080, 1860, 2160, 2520]
    assert configured(Run, days=2).horizon_min == 2880.0


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"habits": ["unannounced"]}, "announce the meals"),
        ({"habits": ["snack, time=21h"], "duration_min": 600.0}, r"snack at 1260 min begins after the run ends at 600"),
        ({"habits": ["snak"]}, "did you mean 'snack'"),
        ({"habits": ["skipped, probability=1.5"]}, "a number from 0 to 1"),
        ({"warm_up_min": 7.0}, "a warm-up of 7 min is not a whole number of 5-min samples"),
        ({"days": 2, "duration_min": 600.0}, "leave one out"),
        ({"warm_up_min": 500_000.0, "days": 30}, "a warm-up of 500000 min before 43200 min"),
    ],
)
def test_what_cannot_be_meant_is_refused(keys, says):
    for root in (Run, Trial):
        with pytest.raises(Refusal, match=says):
            _ = configured(root, keys).plan
