"""A pump whose commands expire."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.faults import Unheard, never, once
from glucoloop.pumps import Expiring, LimitedPump, dose_limits, rate_in_force

KEY = jax.random.key(0)
FREE = LimitedPump(limits=dose_limits(max_change_mU_min=1000.0, max_mU_min=1000.0))


def delivered(pump, commands, basal=20.0):
    state = pump.init(jnp.asarray(basal), KEY)
    rates = []
    for command in commands:
        state, delivery = pump.deliver(state, jnp.asarray(command), KEY)
        assert delivery.reported_mU_min == delivery.insulin_mU_min
        rates.append(float(delivery.insulin_mU_min))
    return rates


def test_a_pump_that_hears_nothing_goes_back_to_the_basal_rate():
    nothing = float("nan")
    commands = [40.0, nothing, nothing, nothing, 30.0, nothing, nothing]
    assert delivered(Expiring(2, inner=FREE), commands) == [40.0, 40.0, 20.0, 20.0, 30.0, 30.0, 20.0]
    assert delivered(Expiring(1, inner=FREE), commands) == [40.0, 20.0, 20.0, 20.0, 30.0, 20.0, 20.0]


def test_a_pump_that_stopped_starts_again_as_well():
    assert delivered(Expiring(1, inner=FREE), [0.0, float("nan")]) == [0.0, 20.0]


def test_the_way_back_keeps_the_limits():
    rates = delivered(Expiring(1), [30.0, 45.0, 60.0, *[float("nan")] * 4])
    assert np.abs(np.diff(rates)).max() <= 16.7 + 1e-12
    assert rates[-1] == 20.0


@given(st.lists(st.floats(0.0, 1000.0), min_size=1, max_size=8))
def test_while_all_is_heard_it_is_the_pump_inside_to_the_bit(commands):
    assert delivered(Expiring(), commands) == delivered(LimitedPump(), commands)


@pytest.mark.parametrize(
    ("command", "until", "now", "rate"),
    [(40.0, 45.0, 44.9, 40.0), (40.0, 45.0, 45.0, 20.0), (40.0, np.nan, 0.0, 20.0), (np.nan, 45.0, 0.0, 20.0)],
)
def test_a_rate_is_in_force_until_it_expires(command, until, now, rate):
    assert rate_in_force(*map(jnp.asarray, (command, until, now, 20.0))) == rate


def test_what_is_not_heard_expires():
    commands = [40.0, 50.0, 50.0, 50.0, 30.0]
    assert delivered(Unheard(schedule=once(1, 3), inner=Expiring(2, inner=FREE)), commands) == [
        40.0,
        40.0,
        20.0,
        20.0,
        30.0,
    ]
    assert delivered(Unheard(schedule=never()), commands) == delivered(LimitedPump(), commands)


@pytest.mark.parametrize("samples", [0, -1, 1.5, True])
def test_samples_that_cannot_be_are_refused(samples):
    with pytest.raises(ValueError, match="give a whole number"):
        Expiring(samples)
