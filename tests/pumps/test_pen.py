"""Pens: what is injected is released, whole steps of doses, when injections come, and a loop with them."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.pumps import LimitedPump, Pen, bolus_limits, dose_limits
from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.therapy import insulin_left

KEY = jax.random.key(4)
FREE = LimitedPump(
    limits=dose_limits(max_change_mU_min=1000.0, max_mU_min=1000.0), bolus=bolus_limits(min_U=0.5, step_U=0.5)
)
DAY = 288


def delivered(pump, rates, bolus=0.0, start=None):
    """Deliveries of rates that are asked for at each sample."""

    def one(state, rate):
        return pump.deliver(state, rate, KEY, jnp.asarray(bolus))

    first = pump.init(jnp.asarray(rates[0] if start is None else start), KEY)
    return jax.lax.scan(one, first, jnp.asarray(rates))[1]


@pytest.mark.long
@settings(max_examples=20, deadline=None)
@given(
    insulin=st.sampled_from(["glargine", "glargine-u300", "detemir", "degludec"]),
    injections=st.integers(1, 3),
    rate=st.floats(3.0, 40.0),
    at=st.floats(0.0, 1439.0),
)
def test_a_day_releases_what_is_injected_in_a_day(insulin, injections, rate, at):
    pump = Pen(insulin, injections, at, 0.5, 0.3, inner=FREE)
    found = delivered(pump, np.full(4 * DAY, rate))
    daily = injections * 500.0 * math.floor(rate * 1440.0 / injections / 500.0 + 0.5)
    of_days = 5.0 * np.asarray(found.insulin_mU_min).reshape(4, DAY).sum(axis=1)
    np.testing.assert_allclose(of_days, daily, rtol=1e-9)
    np.testing.assert_allclose(found.reported_mU_min, daily / 1440.0, rtol=1e-12)


def test_one_dose_is_released_by_the_curve():
    """After days without basal insulin one is injected; nothing is left of any other."""
    pump = Pen("detemir", 1, 0.0, 0.5, 0.25, inner=FREE)
    rates = np.r_[np.full(DAY, 10.0), np.zeros(2 * DAY)]
    found = np.asarray(delivered(pump, rates, start=0.0).insulin_mU_min)
    since = 5.0 * np.arange(2 * DAY + 1)
    left = np.asarray(insulin_left(since, 60.0 * 20.0, 60.0 * 20.0 / 3.0))
    np.testing.assert_allclose(found[:DAY], 0.0, atol=1e-12)
    np.testing.assert_allclose(found[DAY:], -14_500.0 * np.diff(left) / 5.0, atol=1e-9)
    assert 5.0 * found.sum() == pytest.approx(14_500.0)


def test_a_dose_is_what_was_asked_for_since_the_last_one():
    pump = Pen("degludec", 2, 360.0, 0.5, 0.25, inner=FREE)
    rates = np.r_[np.full(72, 20.0), np.full(144, 10.0), np.full(72, 30.0)]
    reported = np.asarray(delivered(pump, rates).reported_mU_min) * 720.0
    assert reported[0] == reported[71] == pytest.approx(14_500.0)  # 20 mU/min for 12 h are 14.4 U
    assert reported[72] == reported[215] == pytest.approx(14_500.0)
    assert reported[216] == pytest.approx(7_000.0)  # 10 mU/min for 12 h are 7.2 U


def test_boluses_are_injected_in_half_units_and_nothing_is_lost_of_the_basal_insulin():
    found = delivered(Pen(inner=FREE), np.full(10, 15.0), bolus=3370.0)
    np.testing.assert_array_equal(found.bolus_mU, 3000.0)
    np.testing.assert_array_equal(found.reported_bolus_mU, 3000.0)
    without = delivered(Pen(inner=FREE), np.full(10, 15.0))
    np.testing.assert_array_equal(found.insulin_mU_min, without.insulin_mU_min)


@pytest.mark.long
@given(commands=st.lists(st.floats(), min_size=4, max_size=4), bolus=st.floats())
@settings(max_examples=20, deadline=None)
def test_whatever_is_asked_for_it_delivers_a_possible_amount(commands, bolus):
    pump = Pen(at_min=0.0, inner=FREE)
    found = delivered(pump, np.array(commands), bolus=bolus, start=10.0)
    assert found.glucagon_ug is None
    for values in filter(lambda values: values is not None, dataclasses.astuple(found)):
        assert np.all(np.isfinite(values))
        assert np.all(np.asarray(values) >= 0.0)


def test_settings_beyond_their_bounds_are_refused():
    for wrong in ({"insulin": "nph"}, {"injections": 0}, {"dose_step_U": 0.0}, {"at_min": 1440.0}):
        with pytest.raises(Refusal):
            Pen(**wrong)
    with pytest.raises(Refusal, match="sample time of 0 min"):
        Pen(sample_time_min=0.0)


def test_a_situation_with_pens_has_half_units():
    run = configured(Run, patient="hovorka-2004", pump="pen, injections=2", controller=["basal-bolus"])
    assert float(run.bolus.step_mU) == float(run.bolus.min_mU) == 500.0
