"""Extremes, settling and squared error, on courses whose answer can be read off."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glucoloop.metrics import minimum, peak, settling, sum_squared_error

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
def test_settling_is_the_minute_after_the_last_one_outside(glucose, expected, settled):
    found = settling(T, glucose, SETPOINT, band_pct=2.0, from_min=50.0)
    assert found.settling_min == expected
    assert found.settled == settled


def test_a_wider_band_is_entered_earlier():
    glucose = SETPOINT + 30.0 * np.exp(-T / 60.0)
    # outside while 30 exp(-t/60) > band
    for band in (2.0, 5.0, 10.0):
        last = np.floor(60.0 * np.log(30.0 / (band / 100.0 * SETPOINT)))
        assert settling(T, glucose, SETPOINT, band_pct=band).settling_min == last + 1


def test_extremes_are_told_with_their_first_moment():
    glucose = course(m100=60.5, m200=60.5, m400=99.0, m410=99.0)
    low, high = minimum(T, glucose), peak(T, glucose)
    assert (low.value, low.t_min) == (60.5, 100.0)
    assert (high.value, high.t_min) == (99.0, 400.0)


def test_squared_error_is_summed_over_samples():
    assert sum_squared_error([80.0, 83.0, 76.0], SETPOINT) == 25.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_has_no_measure(bad):
    glucose = course(m300=bad)
    assert np.isnan(minimum(T, glucose).value)
    assert np.isnan(minimum(T, glucose).t_min)
    assert np.isnan(peak(T, glucose).value)
    assert np.isnan(peak(T, glucose).t_min)
    assert np.isnan(sum_squared_error(glucose, SETPOINT))
    found = settling(T, glucose, SETPOINT, band_pct=2.0)
    assert np.isnan(found.settling_min)
    assert not found.settled


@settings(deadline=None, max_examples=50)
@given(
    hnp.arrays(float, (61, 3), elements=st.floats(40.0, 300.0)),
    st.floats(70.0, 120.0),
    st.floats(0.5, 50.0),
    st.integers(0, 60),
)
def test_settling_agrees_with_a_search_backwards(glucose, setpoint, band, start):
    found = settling(T[:61], glucose, setpoint, band_pct=band, from_min=float(start))
    for person in range(3):
        outside = [t for t in range(61) if abs(glucose[t, person] - setpoint) > band / 100.0 * setpoint]
        expected = max(outside[-1] + 1 - start, 0) if outside else 0
        assert found.settling_min[person] == expected
        assert bool(found.settled[person]) == (60 not in outside)


def test_many_people_are_measured_as_one_by_one():
    glucose = np.random.default_rng(1).normal(90.0, 10.0, (601, 4))
    setpoint = np.array([80.0, 90.0, 95.0, 100.0])
    together = settling(T, glucose, setpoint, band_pct=20.0, from_min=50.0)
    mapped = jax.vmap(lambda g, s: settling(T, g, s, band_pct=20.0, from_min=50.0), in_axes=(1, 0))(glucose, setpoint)
    np.testing.assert_array_equal(together.settling_min, mapped.settling_min)
    np.testing.assert_array_equal(together.settled, mapped.settled)
