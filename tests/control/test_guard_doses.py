"""Doses that a guard allows, whatever the controller inside wants."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop._pytree import pytree, static
from glucoloop.control import (
    Decision,
    GuardSettings,
    Status,
    guarded,
)
from glucoloop.pumps import DoseLimits
from guarding import BASAL, EVERY, OPEN, SETPOINT, Wants, follow, observe, step


def test_a_predicted_low_suspends_within_the_rate_limit_until_it_has_passed():
    limits = DoseLimits(max_change_mU_min=8.0)
    falling, rising = [100.0 - 4.0 * k for k in range(9)], [69.0, 71.0, 73.0, 78.0, 82.0, 86.0]
    doses, statuses, _ = follow(guarded(Wants(rate=BASAL), GuardSettings(), limits), falling + rising)
    first = statuses.tolist().index(Status.SUSPENDED)
    assert falling[first] > 65.0  # before it is low
    np.testing.assert_allclose(doses[first : first + 4], [12.0, 4.0, 0.0, 0.0], atol=1e-12)
    assert statuses[-1] != Status.SUSPENDED
    assert doses[-1] > 0.0


def test_near_the_setpoint_little_more_than_the_basal_rate_is_given_for_as_long_as_one_asks():
    doses, statuses, _ = follow(guarded(Wants(rate=66.9)), [SETPOINT + 3.0 + 0.1 * (k % 2) for k in range(200)])
    np.testing.assert_allclose(doses, 1.2 * BASAL, rtol=1e-12)
    assert np.all(statuses == Status.DOSE_LIMITED)


@pytest.mark.parametrize("most", [1.5, 2.0, 3.0])
def test_no_hour_gets_more_than_is_allowed(most):
    limits = DoseLimits(max_change_mU_min=66.9)
    rise = [SETPOINT + min(8.0 * k, 200.0) + 0.1 * (k % 2) for k in range(100)]
    settings_ = GuardSettings(max_hour=most, max_on_board=100.0, fall_mg_dl=20.0)
    doses, _, _ = follow(guarded(Wants(rate=66.9), settings_, limits), rise)
    history = np.r_[np.full(11, BASAL), doses]
    hours = np.convolve(history, np.ones(12), "valid")
    assert hours.max() <= most * 12 * BASAL + 1e-9
    assert hours.max() > 0.95 * most * 12 * BASAL


def on_board_of(doses, basal, tau_min=90.0):
    """Insulin on board after each dose, in basal rates beyond the basal rate."""
    kept, after = math.exp(-EVERY / tau_min), [np.zeros(np.shape(basal))]
    for dose in doses:
        after.append(kept * after[-1] + (1.0 - kept) * (dose / basal - 1.0))
    return np.array(after)


@pytest.mark.parametrize("change", [2.0, 16.7, 66.9])
def test_insulin_on_board_reaches_its_cap_and_does_not_pass_it(change):
    rise = [SETPOINT + min(8.0 * k, 250.0) + 0.1 * (k % 2) for k in range(150)]
    settings_ = GuardSettings(max_hour=10.0, max_on_board=0.8, fall_mg_dl=60.0)
    doses, _, _ = follow(guarded(Wants(rate=66.9), settings_, DoseLimits(max_change_mU_min=change)), rise)
    assert on_board_of(doses, BASAL).max() == pytest.approx(0.8, abs=1e-9)


@pytree
class WantsAnything:
    """Asks for a rate that it is told as a meal; above 900 it asks for what is no number."""

    sample_time_min: float = static(default=EVERY)

    def init(self, observation):
        return jnp.zeros_like(observation.glucose_mg_dl)

    def step(self, state, observation):
        told = observation.announced_carbs_g
        return state, Decision(insulin_mU_min=jnp.where(told > 900.0, jnp.nan, told), status=jnp.zeros(told.shape, int))


@jax.jit
def doses_of(guard, start, readings, setpoints, wanted):
    """Doses of people whose pump does as it is asked."""

    def sample(carry, entry):
        state, delivered = carry
        reading, setpoint, want = entry
        state, decision = guard.step(state, observe(reading, delivered, setpoint=setpoint, carbs=want))
        return (state, decision.insulin_mU_min), decision.insulin_mU_min

    state = guard.init(observe(readings[0], start))
    return jax.lax.scan(sample, (state, start), (readings, setpoints, wanted))[1]


@pytest.mark.long
@pytest.mark.parametrize(
    "limits_of_guard",
    [
        GuardSettings(),
        GuardSettings(max_hour=1.1, max_on_board=0.05, fall_mg_dl=1.0, error_mg_dl=0.0, low_mg_dl=0.0),
        GuardSettings(max_hour=1.7, max_on_board=0.6, fall_mg_dl=5.0, always_basal=3.0, on_board_tau_min=20.0),
        GuardSettings(max_hour=3.0, max_on_board=0.9, fall_mg_dl=5.0, on_board_tau_min=300.0, low_mg_dl=0.0),
    ],
)
@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_the_caps_hold_at_every_sample_for_any_readings_and_any_controller(limits_of_guard, seed):
    rng, people, samples = np.random.default_rng(seed), 200, 60
    basal = rng.uniform(1.0, 60.0, people)
    limits = DoseLimits(max_change_mU_min=jnp.asarray(10.0 ** rng.uniform(-1.0, 1.9, people)))
    wandering = 150.0 + np.cumsum(rng.normal(0.0, rng.uniform(0.0, 12.0, people), (samples, people)), axis=0)
    anything = rng.choice([np.nan, np.inf, 0.0, 25.0, 60.0, 81.0, 200.0, 590.0, 1e300], (samples, people))
    readings = np.where(rng.random((samples, people)) < rng.uniform(0.0, 0.5, people), anything, wandering)
    setpoints = np.where(rng.random((samples, people)) < 0.1, rng.choice([np.nan, 30.0, 1e9]), SETPOINT)
    wanted = np.where(rng.random((samples, people)) < 0.8, rng.uniform(0.0, 200.0, people), 0.0)
    wanted = np.where(rng.random((samples, people)) < 0.05, 950.0, wanted)
    guard = dataclasses.replace(guarded(WantsAnything(), limits_of_guard, limits), basal_mU_min=jnp.asarray(basal))
    doses = np.asarray(doses_of(guard, jnp.asarray(basal), readings, setpoints, wanted))
    assert np.all((doses >= 0.0) & (doses <= 66.9))
    assert np.all(np.abs(np.diff(doses, axis=0)) <= limits.max_change_mU_min + 1e-9)
    on_board = on_board_of(doses, basal, limits_of_guard.on_board_tau_min)
    assert np.all(on_board <= limits_of_guard.max_on_board + 1e-9)
    history = np.concatenate([np.tile(basal, (11, 1)), doses])
    hours = np.lib.stride_tricks.sliding_window_view(history, 12, axis=0).sum(axis=-1)
    assert np.all(hours <= limits_of_guard.max_hour * 12.0 * basal * (1.0 + 1e-12))
    assert on_board.max() > 0.3 * limits_of_guard.max_on_board


def test_a_dose_outside_the_limits_is_clipped():
    doses, statuses, _ = follow(guarded(Wants(rate=900.0), OPEN), [200.0] * 5)
    np.testing.assert_allclose(doses, [36.7, 53.4, 66.9, 66.9, 66.9])
    assert np.all(statuses == Status.SATURATED)
    doses, _, _ = follow(guarded(Wants(rate=-900.0), OPEN), [200.0] * 4)
    np.testing.assert_allclose(doses, [3.3, 0.0, 0.0, 0.0], atol=1e-12)


@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(
            st.one_of(st.floats(40.0, 400.0), st.floats(), st.sampled_from([0.0, 2000.0])),
            st.one_of(st.floats(-100.0, 200.0), st.floats()),
        ),
        min_size=12,
        max_size=12,
    )
)
def test_whatever_the_controller_inside_wants_the_dose_keeps_the_limits(rows):
    guard = guarded(Wants(rate=0.0))
    state, delivered = guard.init(observe(rows[0][0])), BASAL
    for reading, rate in rows:
        given_ = dataclasses.replace(guard, inner=Wants(rate=rate))
        state, decision = step(given_, state, observe(reading, delivered))
        dose = float(decision.insulin_mU_min)
        assert 0.0 <= dose <= 66.9
        assert abs(dose - delivered) <= 16.7 + 1e-9
        assert int(decision.status) in set(Status)
        delivered = dose
    for leaf in jax.tree.leaves((state.readings, state.doses, state.setpoint_mg_dl, state.command_mU_min)):
        assert np.all(np.isfinite(leaf))
