"""Boluses: what a pump gives of one, under limits and faults, and where its insulin goes."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.arguments import ArgumentTypeError
from glucoloop.faults import Battery, MissedPulses, Occlusion, Unheard, always, once
from glucoloop.pumps import (
    Delivery,
    Expiring,
    LimitedPump,
    bolus_limits,
    with_resolution,
)
from glucoloop.pumps.protocol import deliver, gives_bolus

KEY = jax.random.key(2)
BOLUSES = st.one_of(st.floats(-5e3, 4e4), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300, 49.9, 50.0]))
SAMPLES = 8


@jax.jit
def scan(pump, commands, boluses):
    def step(state, entry):
        number, command, bolus = entry
        return pump.deliver(state, command, jax.random.fold_in(KEY, number), bolus)

    state = pump.init(jnp.asarray(20.0), KEY)
    return jax.lax.scan(step, state, (jnp.arange(commands.size), commands, boluses))[1]


def given_by(pump, boluses, rate=20.0):
    boluses = np.asarray(boluses, float)
    rates = np.broadcast_to(np.asarray(rate, float), boluses.shape)
    return jax.tree.map(np.asarray, scan(pump, jnp.asarray(rates), jnp.asarray(boluses)))


@settings(max_examples=200)
@given(bolus=BOLUSES)
def test_a_bolus_is_a_whole_number_of_steps_within_the_limits_and_never_more_than_asked(bolus):
    allowed = float(bolus_limits().allowed(jnp.asarray(bolus)))
    assert 0.0 <= allowed <= 25_000.0
    assert math.isclose(allowed / 50.0, round(allowed / 50.0), abs_tol=1e-9)
    if not math.isfinite(bolus) or bolus < 50.0 * (1.0 - 1e-9):
        assert allowed == 0.0
    else:
        asked = min(bolus, 25_000.0)
        assert asked - 50.0 < allowed <= asked * (1.0 + 1e-12)


def test_the_least_bolus_is_given_and_what_is_smaller_is_not():
    limits = bolus_limits(max_U=10.0, min_U=0.5, step_U=0.1)
    asked = jnp.asarray([499.0, 500.0, 549.0, 700.0, 12_345.0])
    np.testing.assert_allclose(limits.allowed(asked), [0.0, 500.0, 500.0, 700.0, 10_000.0], rtol=1e-12)


@pytest.mark.parametrize(
    ("settings", "told"),
    [({"step_U": 0.0}, "steps of 0 U"), ({"max_U": 0.01}, "up to 0.01 U"), ({"max_U": math.inf}, "up to inf U"),
     ({"min_U": -1.0}, "minimum bolus of -1 U"), ({"min_U": 30.0}, "at most the largest, 25 U"),
     ({"min_U": math.nan}, "minimum bolus of nan U")],
)  # fmt: skip
def test_impossible_limits_are_refused_with_a_sentence(settings, told):
    with pytest.raises(ValueError, match=told):
        bolus_limits(**settings)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(BOLUSES, st.floats(0.0, 66.0)), min_size=SAMPLES, max_size=SAMPLES))
def test_a_bolus_leaves_the_basal_rate_as_it_is(doses):
    boluses, rates = zip(*doses, strict=True)
    rates = jnp.asarray(rates)
    both, alone = scan(LimitedPump(), rates, jnp.asarray(boluses)), scan(LimitedPump(), rates, jnp.zeros(SAMPLES))
    np.testing.assert_array_equal(both.insulin_mU_min, alone.insulin_mU_min)
    assert not alone.bolus_mU.any()


def test_without_a_bolus_a_delivery_has_none():
    pump = Battery(schedule=once(1, 1), inner=Occlusion(schedule=always(), inner=with_resolution(0.5, Expiring())))
    _, delivery = pump.deliver(pump.init(jnp.asarray(20.0), KEY), jnp.asarray(20.0), KEY)
    assert delivery.bolus_mU is None
    assert delivery.reported_bolus_mU is None


@pytest.mark.parametrize("noticed", [False, True])
def test_of_a_bolus_into_an_occluded_line_the_rest_is_lost(noticed):
    asked = np.array([1000.0, 2000.0, 3000.0, 4000.0, 0.0, 500.0, 0.0, 0.0])
    told = given_by(Occlusion(open_fraction=0.25, noticed=noticed, schedule=once(2, 2)), asked)
    through = asked * np.array([1, 1, 0.25, 0.25, 1, 1, 1, 1])
    np.testing.assert_array_equal(told.bolus_mU, through)
    np.testing.assert_array_equal(told.reported_bolus_mU, through if noticed else asked)
    # nothing of it comes later: what was asked for is what came and what was lost
    lost = 0.75 * (3000.0 + 4000.0)
    assert told.bolus_mU.sum() + lost == asked.sum()


def test_a_missed_pulse_takes_the_bolus_with_it():
    told = given_by(MissedPulses(0.5), np.full(200, 1000.0))
    missed = told.insulin_mU_min == 0.0
    assert 60 < missed.sum() < 140
    np.testing.assert_array_equal(told.bolus_mU, np.where(missed, 0.0, 1000.0))


def test_a_pump_without_power_gives_no_bolus_and_says_nothing():
    told = given_by(Battery(schedule=once(3, 2)), np.full(SAMPLES, 1000.0))
    off = np.isin(np.arange(SAMPLES), [3, 4])
    np.testing.assert_array_equal(told.bolus_mU, np.where(off, 0.0, 1000.0))
    np.testing.assert_array_equal(told.reported_bolus_mU, np.where(off, np.nan, 1000.0))


def test_a_bolus_that_is_not_heard_is_not_given_and_none_is_given_twice():
    told = given_by(Unheard(schedule=once(3, 2), inner=Expiring(4)), [0.0, 0.0, 700.0, 800.0, 900.0, 0.0, 0.0, 100.0])
    np.testing.assert_array_equal(told.bolus_mU, [0.0, 0.0, 700.0, 0.0, 0.0, 0.0, 0.0, 100.0])
    np.testing.assert_array_equal(told.reported_bolus_mU, told.bolus_mU)


def test_a_resolution_of_the_rate_is_none_of_the_bolus():
    told = given_by(with_resolution(7.0), np.full(SAMPLES, 1234.0), rate=10.0)
    np.testing.assert_array_equal(told.bolus_mU, 1200.0)
    assert set(told.insulin_mU_min) <= {0.0, 7.0, 14.0}


class RatesOnly:
    """A pump from outside that was written before boluses."""

    def init(self, insulin_mU_min, key):
        del key
        return insulin_mU_min

    def deliver(self, state, command_mU_min, key):
        del key
        return command_mU_min, Delivery(insulin_mU_min=command_mU_min, reported_mU_min=command_mU_min)


def test_a_pump_that_can_give_no_bolus_works_without_and_is_refused_with_one():
    pump, rate = Occlusion(schedule=always(), inner=RatesOnly()), jnp.asarray(3.0)
    assert not gives_bolus(pump)
    assert gives_bolus(Occlusion(schedule=always()))
    _, delivery = deliver(pump, pump.init(rate, KEY), rate, KEY, None)
    assert delivery.bolus_mU is None
    with pytest.raises(ArgumentTypeError, match="RatesOnly cannot give a bolus"):
        deliver(pump, pump.init(rate, KEY), rate, KEY, rate)
