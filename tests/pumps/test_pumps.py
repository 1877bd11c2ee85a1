import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.pumps import LimitedPump, dose_limits, with_resolution

RATES = st.floats(0.0, 66.9)
COMMANDS = st.one_of(st.floats(-100.0, 200.0), st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0, 66.9]))

KEY = jax.random.key(0)


@jax.jit
def deliver(pump, state, command):
    state, delivery = pump.deliver(state, command, KEY)
    return state, delivery.insulin_mU_min


@jax.jit
def run(pump, start, commands):
    return jax.lax.scan(functools.partial(deliver, pump), pump.init(start, KEY), commands)[1]


def allowed(command, previous, change=16.7, least=0.0, most=66.9):
    """Rate first, magnitude second, in plain Python."""
    rate = min(max(command, previous - change), previous + change)
    return min(max(rate, least), most)


@settings(max_examples=200)
@given(RATES, st.floats(-100.0, 200.0))
def test_a_command_is_limited_in_rate_and_then_in_magnitude(previous, command):
    _, delivered = deliver(LimitedPump(), jnp.asarray(previous), command)
    assert float(delivered) == pytest.approx(allowed(command, previous), abs=1e-12)


@given(RATES, RATES)
def test_what_is_allowed_is_what_clipping_leaves_alone(previous, wanted):
    limits = dose_limits()
    clipped = float(limits.clip(wanted, previous))
    if abs(abs(wanted - previous) - 16.7) > 1e-9:
        assert bool(limits.allow(wanted, previous)) == (abs(clipped - wanted) < 1e-12)
    assert bool(limits.allow(clipped, previous, 1e-9))


@pytest.mark.parametrize(
    ("rate", "previous", "slack", "allowed"),
    [(16.7, 0.0, 0.0, True), (16.8, 0.0, 0.0, False), (16.8, 0.0, 0.2, True), (67.0, 60.0, 0.0, False),
     (67.0, 60.0, 0.2, True), (-0.1, 5.0, 0.0, False), (-0.1, 5.0, 0.2, True), (np.nan, 5.0, 1.0, False),
     (np.inf, 5.0, 1.0, False)],
)  # fmt: skip
def test_what_is_allowed_and_by_how_much(rate, previous, slack, allowed):
    assert bool(dose_limits().allow(jnp.asarray(rate), jnp.asarray(previous), slack)) is allowed


def test_limits_of_ones_own():
    pump = LimitedPump(limits=dose_limits(max_change_mU_min=2.0, min_mU_min=5.0, max_mU_min=9.0))
    np.testing.assert_allclose(run(pump, 8.0, np.array([100.0, 0.0, 0.0, 0.0, 6.0])), [9.0, 7.0, 5.0, 5.0, 6.0])
    assert float(pump.init(jnp.asarray(1.0), KEY)) == 5.0


def test_full_range_takes_four_moves_with_the_limits_of_the_paper():
    doses = np.asarray(run(LimitedPump(), 0.0, np.full(6, 1e9)))
    np.testing.assert_allclose(doses, [16.7, 33.4, 50.1, 66.8, 66.9, 66.9])


@settings(max_examples=50)
@given(RATES, st.lists(COMMANDS, min_size=12, max_size=12))
def test_limits_are_kept_whatever_the_commands(start, commands):
    doses = np.r_[start, run(LimitedPump(), start, np.array(commands))]
    assert np.all((doses >= 0.0) & (doses <= 66.9))
    assert np.abs(np.diff(doses)).max() <= 16.7 + 1e-12


@pytest.mark.parametrize(("command", "delivered"), [(np.nan, 13.3), (np.inf, 46.7), (-np.inf, 13.3)])
def test_a_command_that_is_not_finite(command, delivered):
    assert float(deliver(LimitedPump(), jnp.asarray(30.0), command)[1]) == pytest.approx(delivered)


@settings(max_examples=60)
@given(st.lists(RATES, min_size=40, max_size=40), st.sampled_from([0.05, 0.1, 1.0, 1.3, 5.0]))
def test_resolution_delivers_whole_steps_and_owes_less_than_one(commands, step):
    wanted = np.asarray(run(LimitedPump(), commands[0], np.array(commands)))
    doses = np.asarray(run(with_resolution(step), commands[0], np.array(commands)))
    steps = doses / step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.all(doses >= 0.0)
    highest = np.floor(66.9 / step + 1e-9) * step
    assert doses.max() <= highest + 1e-9
    if wanted.max() <= highest:
        owed = np.cumsum(wanted - doses)
        assert owed.min() > -1e-6
        assert owed.max() < step + 1e-6


@pytest.mark.parametrize("rate", [22.33, 25.6060573442, 0.07])
def test_resolution_delivers_the_commanded_mean(rate):
    doses = np.asarray(run(with_resolution(1.0), rate, np.full(3000, rate)))
    assert doses.mean() == pytest.approx(rate, abs=1.0 / 3000)
    assert set(np.unique(doses)) <= {np.floor(rate), np.ceil(rate)}


def test_resolution_never_exceeds_the_largest_dose_and_lets_no_debt_grow():
    doses = np.asarray(run(with_resolution(1.0), 66.9, np.r_[np.full(100, 66.9), np.zeros(8)]))
    np.testing.assert_array_equal(doses[:100], 66.0)
    assert doses.max() == 66.0
    # once the command has fallen to zero, at most one step is still owed
    np.testing.assert_allclose(doses[100:104], [51.0, 33.0, 17.0, 0.0], atol=1.0)
    np.testing.assert_array_equal(doses[105:], 0.0)


def test_a_rate_that_is_a_whole_number_of_steps_is_delivered_as_it_is():
    np.testing.assert_allclose(run(with_resolution(0.1), 0.3, np.full(50, 0.3)), 0.3, rtol=1e-12)


@settings(max_examples=50)
@given(st.lists(COMMANDS, min_size=12, max_size=12))
def test_resolution_keeps_the_limits_whatever_the_commands(commands):
    doses = np.asarray(run(with_resolution(0.5), 20.0, np.array(commands)))
    assert np.all((doses >= 0.0) & (doses <= 66.9))
    # the rounding of two doses, each by less than a step
    assert np.abs(np.diff(np.r_[20.0, doses])).max() < 16.7 + 2 * 0.5


@pytest.mark.parametrize("change", [0.0, -1.0, np.nan, np.inf])
def test_an_impossible_rate_limit_is_refused(change):
    with pytest.raises(ValueError, match=r"rate limit of .* is not possible; give a finite value above 0"):
        dose_limits(max_change_mU_min=change)


@pytest.mark.parametrize(
    ("least", "most"), [(-1.0, 5.0), (5.0, 5.0), (6.0, 5.0), (0.0, np.inf), (np.nan, 5.0), (0.0, np.nan)]
)
def test_an_impossible_dose_range_is_refused(least, most):
    with pytest.raises(ValueError, match=r"dose range of .* is not possible; give 0 or more as the lower"):
        dose_limits(min_mU_min=least, max_mU_min=most)


@pytest.mark.parametrize("step", [0.0, -0.1, np.nan, np.inf])
def test_an_impossible_resolution_is_refused(step):
    with pytest.raises(ValueError, match=r"step_mU_min is .* mU/min; give a finite number above 0"):
        with_resolution(step)
