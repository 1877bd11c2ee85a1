"""Bouts of exercise: their minutes against the overlap of intervals, their variation, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import glucoloop as gl
from glucoloop.physiology.exercise import (
    Bouts,
    bouts_of_one,
    draw_bouts,
    exercise_in_order,
    mean_intensity_pct,
    repeated_daily,
)

BOUTS = st.builds(gl.Exercise, st.floats(0.1, 100.0), st.floats(0.0, 400.0), st.floats(1.0, 300.0))


@settings(max_examples=60)
@given(BOUTS, st.lists(st.floats(0.1, 60.0), min_size=1, max_size=30))
def test_a_mean_over_any_grid_keeps_the_effort(bout, lengths):
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    mean = mean_intensity_pct(bouts_of_one([bout]), edges)[:, 0]
    inside = max(0.0, min(bout.t_min + bout.duration_min, edges[-1]) - bout.t_min)
    assert mean @ np.diff(edges) == pytest.approx(bout.intensity_pct * inside, rel=1e-9, abs=1e-9)
    assert np.all((mean >= 0.0) & (mean <= bout.intensity_pct * (1.0 + 1e-12)))


@settings(max_examples=60)
@given(st.lists(BOUTS, max_size=4))
def test_of_bouts_at_once_the_more_intense_counts(bouts):
    edges = np.arange(0.0, 721.0)
    together = mean_intensity_pct(bouts_of_one(bouts), edges)
    each = [mean_intensity_pct(bouts_of_one([bout]), edges) for bout in bouts] or [0.0 * together]
    np.testing.assert_array_equal(together, np.max(each, axis=0))


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ((0.0, 60.0, 30.0), "exercise of 0 % is not possible; give more than 0 and at most 100 %"),
        ((101.0, 60.0, 30.0), "exercise of 101 % is not possible"),
        ((np.nan, 60.0, 30.0), "exercise of nan % is not possible"),
        ((50.0, -1.0, 30.0), "exercise at -1 min is not possible; give a finite time of 0 min or later"),
        ((50.0, np.inf, 30.0), "exercise at inf min is not possible"),
        ((50.0, 60.0, 0.5), "exercise for 0.5 min is not possible; give 1 to 1440 min"),
        ((50.0, 60.0, np.nan), "exercise for nan min is not possible"),
    ],
)
def test_exercise_that_is_not_possible_is_refused(numbers, told):
    with pytest.raises(ValueError, match=told):
        gl.Exercise(*numbers)


def test_a_scenario_takes_bouts_in_any_order_and_refuses_others():
    late, early = gl.Exercise(50.0, 300.0, 30.0), gl.Exercise(20.0, 60.0, 30.0)
    assert gl.Scenario([], 600.0, exercise=[late, early]).exercise == (early, late)
    with pytest.raises(ValueError, match="the exercise at 300 min begins after the end at 300 min; move it, or length"):
        gl.Scenario([], 300.0, exercise=[late])
    with pytest.raises(TypeError, match=r"exercise holds 50.0, which is no exercise; give bouts such as Exercise\(50"):
        gl.Scenario([], 300.0, exercise=[50.0])
    with pytest.raises(ValueError, match="101 bouts of exercise are too many; give at most 100"):
        exercise_in_order([early] * 101, 600.0)


def test_a_person_has_the_same_bouts_whoever_else_is_drawn():
    days = repeated_daily([gl.Exercise(50.0, 600.0, 30.0), gl.Exercise(90.0, 1100.0, 45.0)], 3)
    spreads = {"intensity_spread_pct": 40.0, "time_spread_min": 60.0, "a_day": 2}
    many = draw_bouts(days, 7, np.arange(1000), **spreads)
    alone = draw_bouts(days[:4], 7, [412], **spreads)
    for name in vars(many):
        np.testing.assert_array_equal(getattr(alone, name)[:, 0], getattr(many, name)[:4, 412])
    assert np.ptp(many.intensity_pct[0]) > 35.0
    assert many.intensity_pct.max() == 100.0  # 90 % and more than a ninth of it
    assert np.all(np.abs(many.t_min[0] - 600.0) <= 60.0)
    assert abs(np.corrcoef(many.t_min[0], many.t_min[2])[0, 1]) < 0.15
    assert np.all(many.duration_min[1] == 45.0)
    plain = draw_bouts(days, 7, np.arange(3))
    np.testing.assert_array_equal(plain.t_min[:, 2], [bout.t_min for bout in days])


def test_a_bout_within_a_minute_has_its_mean_there():
    bouts = Bouts(*np.array([[[60.0]], [[10.25]], [[1.5]]]))
    np.testing.assert_allclose(mean_intensity_pct(bouts, [9.0, 10.0, 11.0, 12.0])[:, 0], [0.0, 45.0, 45.0])
