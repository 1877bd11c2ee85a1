"""Extremes, settling and squared error, on courses whose answer can be read off."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glucoloop.metrics.metric import of_glucose
from glucoloop.metrics.regulation import Settling

T = np.arange(601.0)
SETPOINT = 80.0


def course(**outside):
    """80 mg/dl throughout, but for the given minutes."""
    glucose = np.full(601, SETPOINT)
    for minute, value in outside.items():
        glucose[int(minute[1:])] = value
    return glucose


@pytest.mark.parametrize(
    ("glucose", "expected", "settled"),
    [
        (course(), 0.0, True),
        (course(m100=81.6), 0.0, True),  # on the edge of the band is inside
        (course(m100=81.7), 51.0, True),
        (course(m100=90.0, m300=78.3), 251.0, True),
        (course(m599=78.3), 550.0, True),
        (course(m600=78.3), 551.0, False),
        (course(m20=90.0), 0.0, True),  # before the meal, and back in time
    ],
)
def test_settling_is_the_minute_after_the_last_one_outside(measured, glucose, expected, settled):
    found = measured(glucose, inside=5, meal_sample=10)  # which is at 50 min
    assert found.settling_2pct_min == expected
    assert found.settled_2pct == settled


def test_a_wider_band_is_entered_earlier(measured):
    found = measured(SETPOINT + 30.0 * np.exp(-T / 60.0))
    # outside while 30 exp(-t/60) > band
    for band, settling in ((2.0, found.settling_2pct_min), (5.0, found.settling_5pct_min)):
        assert settling == np.floor(60.0 * np.log(30.0 / (band / 100.0 * SETPOINT))) + 1


def test_extremes_are_told_with_their_first_moment(measured):
    found = measured(course(m100=60.5, m200=60.5, m400=99.0, m410=99.0))
    assert (found.minimum_mg_dl, found.minimum_t_min) == (60.5, 100.0)
    assert (found.peak_mg_dl, found.peak_t_min) == (99.0, 400.0)


def test_squared_error_is_summed_over_samples(measured):
    assert measured([80.0, 83.0, 76.0, 99.0]).sse == 25.0  # no sample is taken at the end


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_has_no_measure(measured, bad):
    found = measured(course(m300=bad))
    for name in ("minimum_mg_dl", "minimum_t_min", "peak_mg_dl", "peak_t_min", "sse", "settling_2pct_min"):
        assert np.isnan(getattr(found, name)), name
    assert not found.settled_2pct


@pytest.mark.long
@settings(deadline=None, max_examples=50)
@given(hnp.arrays(float, (61, 3), elements=st.floats(70.0, 90.0)), st.floats(70.0, 90.0), st.integers(0, 60))
def test_settling_agrees_with_a_search_backwards(glucose, setpoint, start):
    found = of_glucose(Settling(), T[:61], glucose, setpoint, float(start))
    for band in (2, 5):
        for person in range(3):
            outside = [t for t in range(61) if abs(glucose[t, person] - setpoint) > band / 100.0 * setpoint]
            expected = max(outside[-1] + 1 - start, 0) if outside else 0
            assert found[f"settling_{band}pct_min"][person] == expected
            assert bool(found[f"settled_{band}pct"][person]) == (60 not in outside)
