"""Whether an observation is fresh, and until when a decision holds."""

import itertools
import math

import jax
import jax.numpy as jnp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.control import Decision
from glucoloop.control.real_time import Arrival, Stamp, holding, observation, receive, received

ANY = st.one_of(st.floats(), st.integers(-(10**400), 10**400), st.none(), st.text(max_size=3), st.booleans())


def reading(number=7, read_t_min=35.0, glucose=104.0):
    return observation(glucose, setpoint_mg_dl=100.0, delivered_mU_min=22.3, number=number, read_t_min=read_t_min)


@pytest.mark.parametrize(
    ("seen", "now_min", "arrival"),
    [
        (reading(), 35.2, Arrival.ON_TIME),
        (reading(), 40.0, Arrival.ON_TIME),
        (reading(), 40.1, Arrival.LATE),
        (reading(), 34.6, Arrival.ON_TIME),  # within the error of the clocks
        (reading(), 34.4, Arrival.FROM_THE_FUTURE),
        (reading(number=6), 35.0, Arrival.REPEATED),
        (reading(number=6, read_t_min=30.0), 35.0, Arrival.REPEATED),
        (reading(number=5, read_t_min=25.0), 35.0, Arrival.OUT_OF_ORDER),
        (reading(number=7, read_t_min=30.0), 35.0, Arrival.OUT_OF_ORDER),
        (reading(number=None), 35.0, Arrival.UNTIMED),
        (reading(read_t_min="35"), 35.0, Arrival.UNTIMED),
        (reading(number=None, glucose=None), 35.0, Arrival.MISSING),
    ],
)
def test_late_repeated_out_of_order_and_future_readings_are_told_apart(seen, now_min, arrival):
    assert received(Stamp(6.0, 30.0), seen, now_min) == arrival
    told = receive(Stamp(6.0, 30.0), seen, now_min)
    assert told.arrival == arrival
    assert bool(told.observation.valid) == (arrival == Arrival.ON_TIME)


def test_the_first_reading_is_neither_repeated_nor_out_of_order():
    assert received(None, reading(number=-3, read_t_min=0.0), 0.0) == Arrival.ON_TIME


def test_a_wrong_clock_does_not_make_all_that_follows_old():
    wrong = receive(Stamp(6.0, 30.0), reading(number=7, read_t_min=1e6), 35.0)
    assert wrong.last == Stamp(6.0, 30.0)
    assert receive(wrong.last, reading(number=8, read_t_min=40.0), 40.0).arrival == Arrival.ON_TIME


def test_a_late_reading_is_not_used_but_remembered():
    late = receive(None, reading(number=7, read_t_min=20.0), 35.0)
    assert late.last == Stamp(7.0, 20.0)
    assert receive(late.last, reading(number=7, read_t_min=20.0), 35.0).arrival == Arrival.REPEATED


def test_what_is_not_valid_does_not_become_valid_by_being_on_time():
    seen = observation(104.0, setpoint_mg_dl=100.0, delivered_mU_min=22.3, valid=False, number=7, read_t_min=35.0)
    assert not receive(None, seen, 35.0).observation.valid


@given(ANY, ANY, ANY, st.floats(allow_nan=False), st.one_of(st.none(), st.builds(Stamp, st.floats(), st.floats())))
def test_whatever_comes_is_received_in_one_structure(glucose, number, read_t_min, now_min, last):
    seen = observation(glucose, setpoint_mg_dl=100.0, delivered_mU_min=22.3, number=number, read_t_min=read_t_min)
    told = receive(last, seen, now_min)
    plain = observation(104.0, setpoint_mg_dl=100.0, delivered_mU_min=22.3)
    assert jax.tree.structure(told.observation) == jax.tree.structure(plain)
    if told.arrival == Arrival.ON_TIME and last is not None:
        assert told.last.number != last.number
    assert told.arrival.text.endswith(".")


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 60)), max_size=12))
def test_no_reading_is_used_twice_and_none_older_than_one_that_was(messages):
    last, used = None, []
    for now_min, (number, read) in enumerate(messages):
        told = receive(last, reading(number=number, read_t_min=float(read)), float(now_min))
        last = told.last
        if told.observation.valid:
            used.append((number, read))
    assert all(a[0] < b[0] and a[1] < b[1] for a, b in itertools.pairwise(used))


def test_a_decision_says_until_when_it_holds():
    decision = Decision(insulin_mU_min=jnp.asarray(22.0), status=jnp.asarray(0))
    assert decision.holds_until_min is None
    assert float(holding(decision, 35.0, sample_time_min=5.0).holds_until_min) == 45.0
    with pytest.raises(ValueError, match="holds for 0 samples"):
        holding(decision, 35.0, sample_time_min=5.0, samples=0)
    with pytest.raises(ValueError, match="sample"):
        holding(decision, 35.0, sample_time_min=math.nan)
