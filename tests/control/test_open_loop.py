"""The baseline: a constant rate, and nothing that is read changes it."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.control import Status, design_open_loop
from glucoloop.pumps import dose_limits
from observing import observing

step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
observe = observing(setpoint=100.0)


@settings(max_examples=30)
@given(st.lists(st.floats(), min_size=6, max_size=6))
def test_it_goes_on_with_the_rate_that_it_found(readings):
    controller = design_open_loop()
    state = controller.init(observe(readings[0], 25.0))
    for reading in readings:
        state, decision = step(controller, state, observe(reading, 25.0))
        assert float(decision.insulin_mU_min) == 25.0
        assert int(decision.status) == (Status.OK if np.isfinite(reading) else Status.READING_MISSING)


def test_a_rate_of_ones_own_is_reached_as_fast_as_the_pump_may():
    controller = design_open_loop(60.0)
    state, delivered, doses = controller.init(observe(100.0, 20.0)), 20.0, []
    for _ in range(4):
        state, decision = step(controller, state, observe(100.0, delivered))
        delivered = float(decision.insulin_mU_min)
        doses.append((delivered, Status(int(decision.status))))
    rates, statuses = zip(*doses, strict=True)
    np.testing.assert_allclose(rates, [36.7, 53.4, 60.0, 60.0], rtol=1e-12)
    assert statuses == (Status.SATURATED, Status.SATURATED, Status.OK, Status.OK)


def test_it_returns_to_its_rate_if_the_pump_gave_another():
    controller = design_open_loop()
    state = controller.init(observe(100.0, 25.0))
    _, decision = step(controller, state, observe(100.0, 18.0))
    assert float(decision.insulin_mU_min) == 25.0


def test_it_keeps_one_rate_for_everybody():
    controller = design_open_loop(20.0)
    seen = observe(np.array([80.0, 90.0, 100.0]), np.array([20.0, 15.0, 25.0]))
    _, decision = step(controller, controller.init(seen), seen)
    np.testing.assert_array_equal(decision.insulin_mU_min, 20.0)


@pytest.mark.parametrize("rate", [-1.0, 67.0, np.nan, np.inf])
def test_a_rate_that_cannot_be_delivered_is_refused(rate):
    with pytest.raises(ValueError, match=rf"rate of {rate:g} mU/min is not possible; give one from 0 to 66.9 mU/min"):
        design_open_loop(rate)


def test_the_limits_are_those_of_the_pump():
    limits = dose_limits(min_mU_min=5.0, max_mU_min=30.0)
    assert float(design_open_loop(30.0, limits).insulin_mU_min) == 30.0
    with pytest.raises(ValueError, match="rate of 4 mU/min is not possible; give one from 5 to 30 mU/min"):
        design_open_loop(4.0, limits)


@pytest.mark.parametrize(("rate", "sample_time"), [(None, 0.0), (20.0, -5.0), (20.0, np.nan)])
def test_a_sample_time_that_is_not_possible_is_refused(rate, sample_time):
    with pytest.raises(ValueError, match=rf"sample time of {sample_time:g} min is not possible; give a finite value"):
        design_open_loop(rate, sample_time_min=sample_time)
