import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.faults import Battery, Occlusion, always, once
from glucoloop.pumps import LimitedPump, dose_limits, with_resolution

KEY = jax.random.key(0)
SAMPLES = 30


@jax.jit
def run(pump, start, commands):
    """What is delivered and what is reported."""

    def deliver(state, command):
        return pump.deliver(state, command, KEY)

    delivery = jax.lax.scan(deliver, pump.init(start, KEY), commands)[1]
    return delivery.insulin_mU_min, delivery.reported_mU_min


def doses_of(pump, start, commands):
    return np.asarray(run(pump, jnp.asarray(float(start)), jnp.asarray(commands, float))[0])


def plain(wanted, step, least, most):
    owed, doses = 0, []
    for rate in wanted:
        due = rate + owed
        dose = math.floor(min(due, most) / step + 1e-9) * step
        dose = dose if dose > least - step / 2 else 0.0
        owed = min(due - dose, max(step, least))
        doses.append(dose)
    return doses


@settings(max_examples=80)
@given(
    st.lists(st.floats(0.0, 8.0), min_size=SAMPLES, max_size=SAMPLES),
    st.sampled_from([0.05, 0.25, 1.0]),
    st.integers(0, 6),
)
def test_a_least_dose_is_owed_until_it_is_reached(commands, step, steps):
    least = steps * step
    wanted = doses_of(LimitedPump(), commands[0], commands)
    doses = doses_of(with_resolution(step, least_mU_min=least), commands[0], commands)
    np.testing.assert_allclose(doses, plain(wanted, step, least, 66.9), atol=1e-9)
    assert np.all((doses == 0.0) | (doses >= least - 1e-9))
    np.testing.assert_allclose(doses / step, np.round(doses / step), atol=1e-6)
    owed = np.cumsum(wanted - doses)
    assert owed.min() > -1e-6
    assert owed.max() < max(step, least) + 1e-6


def test_a_small_rate_is_delivered_on_the_mean():
    pump = with_resolution(0.05, least_mU_min=0.5)
    doses = doses_of(pump, 0.07, np.full(3000, 0.07))
    assert doses.mean() == pytest.approx(0.07, abs=0.5 / 3000)
    assert set(np.unique(doses.round(9))) == {0.0, 0.5, 0.55}


def test_a_least_dose_counts_in_whole_steps():
    assert with_resolution(0.2, least_mU_min=0.5).minimum_mU_min == pytest.approx(0.6)
    assert with_resolution(0.1, least_mU_min=0.3).minimum_mU_min == pytest.approx(0.3)
    assert with_resolution(0.1).minimum_mU_min == 0.0


def test_the_limits_of_the_pump_inside_are_kept_unless_others_are_given():
    tight = dose_limits(max_mU_min=4.9, allow_unusual=True)
    high = np.full(12, 100.0)
    assert doses_of(with_resolution(1.0, LimitedPump(limits=tight)), 4.5, high).max() == 4.0
    faulty = Occlusion(open_fraction=0.9, schedule=always(), inner=LimitedPump(limits=tight))
    assert with_resolution(1.0, faulty).limits.max_mU_min == 66.9
    assert doses_of(with_resolution(1.0, limits=tight), 4.5, high).max() == 4.0


def test_any_pump_can_be_inside_and_its_own_report_is_passed_on():
    commands = np.full(10, 10.3)
    for noticed in (False, True):
        pump = with_resolution(0.5, Occlusion(open_fraction=0.5, noticed=noticed, schedule=once(3, 4)))
        delivered, reported = (np.asarray(part) for part in run(pump, jnp.asarray(10.3), jnp.asarray(commands)))
        there = np.isin(np.arange(10), range(3, 7))
        np.testing.assert_allclose(delivered % 0.5, 0.0, atol=1e-9)
        assert np.all(delivered[there] <= 5.5)
        np.testing.assert_array_equal(reported[~there], delivered[~there])
        np.testing.assert_array_equal(reported[there], delivered[there] if noticed else 10.3)
    _, silent = run(with_resolution(0.5, Battery(schedule=once(3, 4))), jnp.asarray(10.3), jnp.asarray(commands))
    np.testing.assert_array_equal(np.isnan(silent), there)


def test_people_are_each_alone():
    rates = np.array([0.07, 3.1, 20.26])
    pump = with_resolution(0.05, least_mU_min=0.5)
    together = np.asarray(run(pump, jnp.asarray(rates), jnp.asarray(np.tile(rates, (SAMPLES, 1))))[0])
    for i, rate in enumerate(rates):
        np.testing.assert_array_equal(together[:, i], doses_of(pump, rate, np.full(SAMPLES, rate)))


@pytest.mark.parametrize("least", [-0.1, 67.0, math.nan, math.inf])
def test_an_impossible_least_dose_is_refused(least):
    with pytest.raises(ValueError, match=r"(minimum dose of|least_mU_min is) .* mU/min( is not possible)?; give"):
        with_resolution(1.0, least_mU_min=least)
    with pytest.raises(ValueError, match=r"minimum dose of 66.5 mU/min is not possible"):
        with_resolution(1.0, least_mU_min=66.5)
