"""Events of low glucose."""

import numpy as np
import pytest

from glucoloop.metrics.glycemia import samples_in_a_row

ROW = 40


@pytest.mark.parametrize(
    ("lows", "events"), [([(4, 6)], 0), ([(4, 7)], 1), ([(4, 7), (9, 14)], 1), ([(4, 7), (10, 13)], 2), ([(38, 40)], 0)]
)
def test_what_is_an_event(measured, lows, events):
    glucose = np.full(5 * ROW + 1, 81.0)
    for start, end in lows:
        glucose[5 * start : 5 * end] = 65.0
    assert int(measured(glucose, inside=5).low_events) == events


def test_people_trail(measured):
    glucose = np.full((5 * ROW + 1, 2), 81.0)
    glucose[25:100, 1] = 40.0
    np.testing.assert_array_equal(measured(glucose, inside=5).very_low_events, [0.0, 1.0])


@pytest.mark.parametrize(
    ("sample_time_min", "samples"), [(1.0, 15), (5.0, 3), (6.0, 3), (10.0, 2), (11.0, 2), (15.0, 1), (30.0, 1)]
)
def test_a_quarter_of_an_hour_in_samples(sample_time_min, samples):
    assert samples_in_a_row(sample_time_min) == samples
