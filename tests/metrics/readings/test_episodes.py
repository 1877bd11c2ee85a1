"""Episodes of low and high glucose, at the edges of their definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.metrics.readings.episodes import BOUNDS_MG_DL, episode_counts, glucose_episodes
from glucoloop.metrics.readings.series import Readings


def course(*pieces, interval_min=5.0):
    """Readings at 10 h and on, each piece a glucose and a number of readings."""
    glucose = np.concatenate([np.full(count, value) for value, count in pieces])
    return Readings.of(600.0 + interval_min * np.arange(glucose.size), glucose)


@pytest.mark.parametrize(("low", "expected"), [(2, 0), (3, 1)])
def test_an_episode_begins_after_a_quarter_of_an_hour(low, expected):
    assert len(glucose_episodes(course((100.0, 6), (69.0, low), (100.0, 6)), "low")) == expected


@pytest.mark.parametrize(("between", "expected"), [(2, [50.0]), (3, [20.0, 20.0])])
def test_an_episode_ends_after_a_quarter_of_an_hour(between, expected):
    found = glucose_episodes(course((100.0, 6), (65.0, 4), (70.0, between), (65.0, 4), (100.0, 6)), "low")
    assert [one.duration_min for one in found] == expected


def test_the_bounds_themselves_are_in_no_episode():
    for kind, bound in BOUNDS_MG_DL.items():
        beyond = -1.0 if bound < 100.0 else 1.0
        assert not glucose_episodes(course((120.0, 3), (bound, 9), (120.0, 3)), kind)
        [one] = glucose_episodes(course((120.0, 3), (bound + beyond, 9), (120.0, 3)), kind)
        assert (one.t_min, one.duration_min, one.extreme_mg_dl) == (615.0, 45.0, bound + beyond)


def test_a_single_reading_of_a_quarter_of_an_hour_is_an_episode():
    [one] = glucose_episodes(course((100.0, 3), (60.0, 1), (100.0, 3), interval_min=15.0), "low")
    assert one.duration_min == 15.0


@pytest.mark.parametrize(("readings", "extended"), [(24, 0), (25, 1)])
def test_an_extended_episode_is_longer_than_two_hours(readings, extended):
    counts = episode_counts(course((100.0, 3), (60.0, readings), (100.0, 3)))
    assert counts["extended_low_events"] == extended


@pytest.mark.parametrize(("begin_min", "nocturnal"), [(0.0, 1), (355.0, 1), (360.0, 0), (1435.0, 0)])
def test_the_night_is_from_0_to_6_h(begin_min, nocturnal):
    t_min = begin_min + 5.0 * np.arange(8)
    counts = episode_counts(Readings.of(t_min, [60.0] * 4 + [100.0] * 4))
    assert (counts["low_events"], counts["nocturnal_low_events"]) == (1, nocturnal)


@pytest.mark.parametrize(("gap_min", "expected"), [(45.0, 1), (46.0, 2)])
def test_a_long_gap_parts_an_episode(gap_min, expected):
    t_min = np.concatenate([5.0 * np.arange(7), 30.0 + gap_min + 5.0 * np.arange(7)])
    assert len(glucose_episodes(Readings.of(t_min, np.full(14, 60.0)), "low")) == expected


@given(st.lists(st.sampled_from([50.0, 60.0, 70.0, 100.0, 200.0, 300.0]), min_size=8, max_size=200))
def test_episodes_are_those_of_a_count_reading_by_reading(glucose):
    """The rule word by word, as `metrics.glycemia.LowEvents` counts in a loop."""
    readings = Readings.of(5.0 * np.arange(len(glucose)), glucose)
    for kind, bound in BOUNDS_MG_DL.items():
        begun, going, in_a_row = 0, False, 0
        for value in glucose:
            beyond = value < bound if bound < 100.0 else value > bound
            in_a_row = in_a_row + 1 if beyond != going else 0
            if in_a_row == 3:
                begun, going, in_a_row = begun + (not going), not going, 0
        assert len(glucose_episodes(readings, kind)) == begun
