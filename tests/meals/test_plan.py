"""Meal plans: drawn meals are those of the plan, within its spreads, and the same in any company."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.meals import Meal, MealPlan, draw_meals

DAY = (Meal(45.0, 420.0), Meal(70.0, 740.0), Meal(60.0, 1130.0))


def test_without_a_spread_all_eat_exactly_the_plan():
    plan = MealPlan(DAY, days=3)
    drawn = draw_meals(plan, 1, np.arange(5))
    t_min, carbs_g = drawn.t_min, drawn.carbs_g
    assert t_min.shape == carbs_g.shape == (9, 5)
    assert not plan.varies
    for row, meal in enumerate(plan.nominal()):
        day, which = divmod(row, 3)
        assert meal == Meal(DAY[which].carbs_g, 1440.0 * day + DAY[which].t_min)
        assert (t_min[row] == meal.t_min).all()
        assert (carbs_g[row] == meal.carbs_g).all()


def test_meals_are_eaten_for_as_long_as_the_plan_says():
    plan = MealPlan([Meal(45.0, 420.0, 15.0), Meal(70.0, 740.0)], days=2, size_spread_pct=30.0, time_spread_min=60.0)
    assert [meal.eating_min for meal in plan.nominal()] == [15.0, 0.0, 15.0, 0.0]
    np.testing.assert_array_equal(
        draw_meals(plan, 1, np.arange(3)).eating_min, [[15.0] * 3, [0.0] * 3, [15.0] * 3, [0.0] * 3]
    )


def test_size_and_time_are_uniform_and_independent():
    plan = MealPlan(DAY, days=2, size_spread_pct=30.0, time_spread_min=60.0)
    drawn = draw_meals(plan, 5, np.arange(8000))
    t_min, carbs_g = drawn.t_min, drawn.carbs_g
    relative = []
    for row, meal in enumerate(plan.nominal()):
        relative += [(t_min[row] - meal.t_min) / 60.0, (carbs_g[row] / meal.carbs_g - 1.0) / 0.3]
    for values in relative:
        assert scipy.stats.kstest(values, scipy.stats.uniform(-1, 2).cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(relative) - np.eye(12)).max() < 0.05


def test_a_meal_is_the_same_in_any_company_and_for_any_number_of_days():
    plan = MealPlan(DAY, days=3, size_spread_pct=30.0, time_spread_min=60.0)
    whole = vars(draw_meals(plan, 5, np.arange(1000)))
    some = np.random.default_rng(0).integers(0, 1000, 77)
    for name, alone in vars(draw_meals(plan, 5, some)).items():
        assert np.array_equal(alone, whole[name][:, some])
    shorter = MealPlan(DAY, days=1, size_spread_pct=30.0, time_spread_min=60.0)
    for name, day in vars(draw_meals(shorter, 5, np.arange(1000))).items():
        assert np.array_equal(day, whole[name][:3])
    assert not np.array_equal(draw_meals(plan, 6, some).t_min, whole["t_min"][:, some])


def test_one_spread_does_not_move_the_other():
    both = MealPlan(DAY, size_spread_pct=30.0, time_spread_min=60.0)
    assert np.array_equal(
        draw_meals(MealPlan(DAY, size_spread_pct=30.0), 1, np.arange(9)).carbs_g,
        draw_meals(both, 1, np.arange(9)).carbs_g,
    )
    assert np.array_equal(
        draw_meals(MealPlan(DAY, time_spread_min=60.0), 1, np.arange(9)).t_min,
        draw_meals(both, 1, np.arange(9)).t_min,
    )


def test_a_run_has_its_days_or_a_length_of_its_own():
    assert MealPlan(DAY).horizon_min == 1440.0
    assert MealPlan(DAY, days=7).horizon_min == 7 * 1440.0
    assert MealPlan([Meal(50.0, 50.0)], horizon_min=600).day_min == 600.0
    assert MealPlan([Meal(50.0, 2000.0)], horizon_min=2880.0).day_min == 2880.0
    assert MealPlan(meal for meal in reversed(DAY)) == MealPlan(DAY)
    assert draw_meals(MealPlan([]), 0, np.arange(3)).t_min.shape == (0, 3)


@given(
    st.lists(st.tuples(st.floats(0.1, 1000.0), st.floats(0.0, 3000.0)), max_size=4),
    st.integers(1, 3),
    st.floats(0.0, 120.0),
    st.floats(0.0, 300.0),
)
def test_a_plan_is_refused_or_its_meals_stay_within_their_days(meals, days, size, time):
    try:
        plan = MealPlan([Meal(*meal) for meal in meals], days, size_spread_pct=size, time_spread_min=time)
    except ValueError:
        return
    drawn = draw_meals(plan, 0, np.arange(50))
    t_min, carbs_g = drawn.t_min, drawn.carbs_g
    start = 1440.0 * np.repeat(np.arange(days), len(meals))[:, None]
    assert ((t_min >= start) & (t_min <= start + 1440.0)).all()
    assert ((carbs_g > 0.0) & (carbs_g <= 1000.0)).all()


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"days": 0}, "days is 0; give a whole number from 1 to 366"),
        ({"days": 1.5}, r"days is 1\.5, a float; give a whole number"),
        ({"days": True}, "days is True"),
        ({"horizon_min": 0.0}, "a horizon of 0 min is not possible"),
        ({"horizon_min": float("nan")}, "a horizon of nan min is not possible"),
        ({"days": 2, "horizon_min": 600.0}, "is not that of 2 days; leave it out, or give 2880 min"),
        ({"horizon_min": 1000.0}, "meal at 1130 min begins after the run ends at 1000 min; move the meal or lengthen"),
        ({"days": 2, "meals": [Meal(9.0, 1440.0)]}, "begins after the day ends at 1440 min; move the meal$"),
        ({"size_spread_pct": 100.0}, "a spread of meals of 100 % is not possible; give 0 to below 100 %"),
        ({"size_spread_pct": float("nan")}, "a spread of meals of nan %"),
        ({"time_spread_min": -1.0}, "a spread of meal times of -1 min is not possible"),
        ({"time_spread_min": 311.0}, "1130 min can begin at 1441 min, which is after the end at 1440 min; .* most 310"),
        (
            {"meals": [Meal(50.0, 50.0)], "time_spread_min": 60.0},
            "can begin at -10 min, which is before the start; .* 50",
        ),
        ({"meals": [Meal(900.0, 50.0)], "size_spread_pct": 20.0}, "meal of 900 g can be 1080 g; give at most 1000 g"),
        ({"meals": [Meal(1.0, 50.0)] * 101}, "101 meals a day are too many"),
    ],
)
def test_an_impossible_plan_is_refused(keys, told):
    with pytest.raises(ValueError, match=told):
        MealPlan(**{"meals": DAY, **keys})
