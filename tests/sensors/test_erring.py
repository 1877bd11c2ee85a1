"""The sensor whose errors are data."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.sensors import DeadTime, IdealSensor, white_noise
from glucoloop.sensors.erring import erring

KEY = jax.random.key(0)


def readings(sensor, glucose):
    state = sensor.init(jnp.asarray(glucose[0]), KEY)
    told = []
    for index, value in enumerate(glucose):
        state, reading = sensor.read(state, jnp.asarray(value), jax.random.fold_in(KEY, index))
        told.append(reading)
    return np.array([r.glucose_mg_dl for r in told]), np.array([r.valid for r in told])


def by_hand(glucose, errors, stuck_from, length):
    """The definition, sample by sample, in plain Python."""
    told = []
    for index, value in enumerate(glucose):
        if any(start < index < start + length for start in stuck_from):
            told.append(told[-1])
        else:
            told.append(value * (1.0 + errors[min(index, len(errors) - 1)]))
    return told


@pytest.mark.long
@given(
    st.lists(st.floats(20.0, 500.0), min_size=1, max_size=9),
    st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=12),
    st.lists(st.integers(0, 12), min_size=1, max_size=3),
    st.integers(1, 5),
)
def test_readings_are_what_the_definition_says(glucose, errors, stuck_from, length):
    told, valid = readings(erring(errors, stuck_from, length), glucose)
    np.testing.assert_allclose(told, by_hand(glucose, errors, stuck_from, length), rtol=1e-14)
    assert valid.all()


def test_without_errors_it_is_the_sensor_inside_to_the_bit():
    glucose = [81.0, 90.5, 101.25, 77.0]
    noisy = white_noise()
    np.testing.assert_array_equal(readings(erring([0.0], inner=noisy), glucose)[0], readings(noisy, glucose)[0])


def test_people_have_errors_of_their_own():
    errors = np.array([[0.1, -0.1], [0.2, -0.2], [0.0, 0.3]])
    glucose = np.array([[100.0, 80.0], [120.0, 90.0], [130.0, 95.0]])
    together, _ = readings(erring(errors, np.array([[0, 9]]), 2), glucose)
    for person, start in ((0, 0), (1, 9)):
        alone, _ = readings(erring(errors[:, person], [start], 2), glucose[:, person])
        np.testing.assert_array_equal(together[:, person], alone)


def test_what_is_not_valid_stays_so_while_the_sensor_is_stuck():
    class Silent(IdealSensor):
        def read(self, state, glucose_mg_dl, key):
            state, reading = super().read(state, glucose_mg_dl, key)
            return state, type(reading)(glucose_mg_dl=reading.glucose_mg_dl, valid=jnp.asarray(glucose_mg_dl > 70.0))

    _, valid = readings(erring([0.0], [1], 2, Silent()), [80.0, 60.0, 90.0, 90.0])
    assert valid.tolist() == [True, False, False, True]


def test_it_goes_around_other_sensors():
    late = DeadTime(5.0)
    told, _ = readings(erring([0.1], inner=late), [80.0, 100.0])
    assert told[1] == pytest.approx(88.0)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (([],), "no error for any sample"),
        ((0.1,), "no error for any sample"),
        (([0.1, np.nan],), "relative error of nan"),
        (([-1.5],), "relative error of -1.5"),
        (([0.1], [-1]), "whole numbers of 0 or more"),
        (([0.1], [0.5]), "whole numbers of 0 or more"),
        (([0.1], [1], 0), "readings of a stretch"),
    ],
)
def test_errors_that_cannot_be_are_refused(arguments, told):
    with pytest.raises(ValueError, match=told):
        erring(*arguments)
