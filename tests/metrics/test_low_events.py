"""Events of low glucose, against a count in plain Python."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.metrics.low_events import low_events, samples_in_a_row

ROW = 40


def counted(glucose, bound, samples):
    """Runs of at least so many lows that are parted by at least so many that are not."""
    events, going, low, high = 0, False, 0, 0
    for value in glucose:
        low, high = (low + 1, 0) if value < bound else (0, high + 1)
        if not going and low == samples:
            events, going = events + 1, True
        elif going and high == samples:
            going = False
    return events


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from([50.0, 69.9, 70.0, 90.0]), min_size=ROW, max_size=ROW), st.sampled_from([1, 3, 15]))
def test_events_are_counted(glucose, samples):
    assert int(low_events(jnp.asarray(glucose), 70.0, samples)) == counted(glucose, 70.0, samples)


@pytest.mark.parametrize(
    ("lows", "events"), [([(4, 6)], 0), ([(4, 7)], 1), ([(4, 7), (9, 14)], 1), ([(4, 7), (10, 13)], 2), ([(38, 40)], 0)]
)
def test_what_is_an_event(lows, events):
    glucose = np.full(ROW, 81.0)
    for start, end in lows:
        glucose[start:end] = 65.0
    assert int(low_events(jnp.asarray(glucose), 70.0, 3)) == events


def test_people_trail():
    glucose = np.full((ROW, 2), 81.0)
    glucose[5:20, 1] = 40.0
    np.testing.assert_array_equal(low_events(jnp.asarray(glucose), 54.0, 3), [0.0, 1.0])


@pytest.mark.parametrize(("sample_time_min", "samples"), [(1.0, 15), (5.0, 3), (10.0, 2), (30.0, 1)])
def test_a_quarter_of_an_hour_in_samples(sample_time_min, samples):
    assert samples_in_a_row(sample_time_min) == samples
