"""Readings that a guard believes, what it does without them, and what else it is told."""

import math

import jax
import numpy as np
import pytest

from glucoloop.control import (
    GuardSettings,
    Status,
    guarded,
)
from guarding import BASAL, LIMITS, MPC, OPEN, SETPOINT, Wants, follow, observe, step


@pytest.mark.parametrize("nonsense", [math.nan, math.inf, -math.inf, -5.0, 0.0, 2000.0, 1e300])
def test_a_reading_that_cannot_be_is_not_handed_on(nonsense):
    guard = guarded(Wants(rate=BASAL))
    _, statuses, states = follow(guard, [SETPOINT, SETPOINT + 1.0, nonsense, SETPOINT + 1.0])
    shown = states[2].inner
    assert not shown.valid
    assert abs(float(shown.glucose_mg_dl) - SETPOINT) < 5.0
    rejected = Status.READING_REJECTED if math.isfinite(nonsense) else Status.OK
    assert statuses.tolist() == [Status.OK, Status.OK, rejected, Status.OK]


@pytest.mark.parametrize("readings", [[math.nan] * 3, [0.0, math.inf, 81.0], [81.0, 5000.0, 90.0]])
def test_it_wakes_at_anything(readings):
    _, _, states = follow(guarded(MPC), readings)
    for leaf in jax.tree.leaves(states):
        assert np.all(np.isfinite(leaf))


def test_a_reading_that_is_too_fast_is_believed_once_glucose_has_had_time():
    limits = GuardSettings(fastest_mg_dl_min=3.0)
    guard = guarded(Wants(rate=BASAL), limits)
    _, statuses, states = follow(guard, [100.0, 116.0, 100.0, 115.0, 160.0, 160.0, 160.0, 160.0])
    # 15 mg/dl in a sample: 16 is too much and 15 is not; 45 takes three samples.
    believed = [bool(state.inner.valid) for state in states]
    assert believed == [True, False, True, True, False, False, True, True]
    assert statuses[4] == Status.READING_REJECTED
    # a fall may be twice as fast
    _, _, states = follow(guard, [100.0, 115.0, 130.0, 145.0, 115.0, 84.0])
    assert [bool(state.inner.valid) for state in states] == [True] * 5 + [False]


def test_under_the_skin_the_rise_after_a_meal_is_believed_and_a_spike_is_not():
    meal = [108.0, 112.0, 130.0, 165.0, 210.0, 255.0, 295.0]  # up to 9 mg/dl/min
    for route, believed in (("subcutaneous", True), ("intravenous", False)):
        guard = guarded(Wants(rate=BASAL), GuardSettings.for_route(route))
        states = follow(guard, meal)[2]
        assert all(bool(state.inner.valid) for state in states[1:]) is believed
        states = follow(guard, [81.0, 82.0, 145.0, 84.0])[2]
        assert [bool(state.inner.valid) for state in states] == [True, True, False, True]


@pytest.mark.parametrize(
    ("readings", "believed"),
    [
        ([101.0, 101.0], [True, True]),  # the error that is thought of is 20 mg/dl
        ([141.0, 81.0, 81.0], [False, True, True]),
        ([141.0, 230.0, 82.0], [False, False, True]),
        ([200.0, 210.0, 205.0], [False, True, True]),  # so high he is
        ([40.0, 41.0], [False, True]),
        ([math.nan, 200.0, math.nan, 203.0], [False, False, False, True]),
    ],
)
def test_a_first_reading_far_from_the_setpoint_waits_for_a_second_one(readings, believed):
    doses, _, states = follow(guarded(Wants(rate=60.0)), readings)
    assert [bool(state.inner.valid) for state in states] == believed
    assert all(float(state.doses.sensor_jump_mg_dl) == 0.0 for state in states[:2])
    assert np.all(doses[~np.array(believed)] <= BASAL)


def test_a_jump_is_put_down_to_the_sensor_and_a_jump_back_takes_it_away():
    guard = guarded(Wants(rate=60.0))
    quiet = [SETPOINT] * 3
    _, statuses, states = follow(guard, [*quiet, *([150.0 + 0.1 * k for k in range(12)])])
    doubted = [float(state.doses.sensor_jump_mg_dl) for state in states]
    assert doubted[3] == 0.0
    assert doubted[8] == pytest.approx(69.0, abs=8.0)
    assert statuses[-1] == Status.DOSE_LIMITED
    _, _, states = follow(guard, [150.0, 150.0, *[SETPOINT + 0.1 * k for k in range(8)], *[150.0] * 8])
    # Unseen glucose is thought to go back to the setpoint, so that the jump down counts for less than the jump up.
    assert float(states[-1].doses.sensor_jump_mg_dl) < 69.0 / 3.0


def test_a_reading_that_is_stuck_is_not_believed_unless_it_is_low():
    limits = GuardSettings(stuck_min=30.0, gap_min=20.0, long_gap_min=60.0)
    rising = [90.0 + 10.0 * k for k in range(13)]
    high = guarded(Wants(rate=60.0), limits)
    _, statuses, states = follow(high, rising + [210.0] * 24 + [200.0])
    believed = [bool(state.inner.valid) for state in states]
    # it is told for the first time in sample 12 and stays so for six more
    first = believed.index(False)
    assert 17 <= first <= 20
    assert not any(believed[first:-1])
    assert believed[-1]
    assert statuses[-2] == Status.FALLBACK_REDUCED
    _, _, states = follow(guarded(Wants(rate=0.0), limits), [70.0, 60.0, *[55.0] * 24])
    assert all(bool(state.inner.valid) for state in states)


def test_a_steady_reading_under_the_basal_rate_is_no_stuck_one():
    _, statuses, _ = follow(guarded(Wants(rate=BASAL)), [SETPOINT] * 48)
    assert np.all(statuses == Status.OK)


@pytest.mark.parametrize("low", [34.0, 50.0, 64.0])
def test_a_possible_low_reading_suspends_however_fast_it_came(low):
    readings = [100.0 + 4.0 * k for k in range(12)] + [144.0] * 3 + [low] * 3
    doses, statuses, states = follow(guarded(Wants(rate=60.0)), readings)
    assert not bool(states[-3].inner.valid)
    assert np.all(statuses[-3:] == Status.SUSPENDED)
    np.testing.assert_allclose(np.diff(doses[-4:]), [max(-16.7, -doses[-4 + k]) for k in range(3)], atol=1e-12)


@pytest.mark.parametrize("reading", [20.0, 66.0, 81.0, 160.0, 400.0])
def test_a_reading_that_is_not_believed_never_adds_insulin(reading):
    """Whatever is told after two hours of one reading, the dose is at most that after a reading that is missing."""
    before = [150.0 + 0.1 * (k % 2) for k in range(24)]
    told, _, states = follow(guarded(Wants(rate=60.0)), [*before, reading])
    missing, _, _ = follow(guarded(Wants(rate=60.0)), [*before, math.nan])
    if not bool(states[-1].inner.valid):
        assert told[-1] <= missing[-1]
    assert missing[-1] == max(BASAL, told[-2] - LIMITS.max_change_mU_min)


def test_a_reading_that_stays_the_same_to_its_last_digit_soon_allows_no_more_than_the_basal_rate():
    rising = [120.0 + 5.0 * k for k in range(6)]
    doses, statuses, states = follow(guarded(Wants(rate=30.0)), [*rising, *[150.0] * 5, 151.0])
    assert bool(states[10].inner.valid)
    # it is told first in sample 6, and for the third time after it in sample 9
    np.testing.assert_allclose(doses[6:], [30.0, 1.2 * BASAL, 1.2 * BASAL, BASAL, BASAL, 30.0])
    assert statuses[6:].tolist() == [Status.OK] + [Status.DOSE_LIMITED] * 4 + [Status.OK]


def test_a_reading_that_stays_the_same_calls_for_no_more_insulin_than_is_on_board():
    limits = GuardSettings(unchanged_min=1000.0, stuck_min=1000.0, max_hour=10.0)
    rising = [100.0 + 5.0 * k for k in range(12)]
    doses, _, states = follow(guarded(Wants(rate=60.0), limits), [*rising, *[155.0] * 20, 156.0])
    on_board = np.array([float(state.doses.on_board) for state in states])
    # the first dose on a held reading may have to come down from a higher one
    assert on_board[13] > 0.5
    np.testing.assert_allclose(on_board[13:33], on_board[13], rtol=1e-6)
    np.testing.assert_allclose(doses[13:32], (1.0 + on_board[13]) * BASAL, rtol=1e-6)
    assert doses[32] > 1.2 * doses[31]


def test_in_a_gap_the_controller_gets_at_most_basal_then_basal_is_given_then_a_part_of_it():
    limits = GuardSettings(gap_min=20.0, long_gap_min=60.0, reduced_fraction=0.4)
    readings = [150.0, 150.1, 150.0] + [math.nan] * 20 + [151.0, 150.0]
    doses, statuses, _ = follow(guarded(Wants(rate=30.0), limits), readings)
    expected = [BASAL] + [30.0] * 2 + [BASAL] * 4 + [BASAL] * 8 + [0.4 * BASAL] * 8 + [0.4 * BASAL + 16.7, 30.0]
    np.testing.assert_allclose(doses, expected, rtol=1e-14)
    names = (
        [Status.DOSE_LIMITED]
        + [Status.OK] * 2
        + [Status.DOSE_LIMITED] * 4
        + [Status.FALLBACK_BASAL] * 8
        + [Status.FALLBACK_REDUCED] * 8
        + [Status.SATURATED, Status.OK]
    )
    assert statuses.tolist() == names


def test_a_low_before_a_gap_suspends_for_a_while_and_not_for_ever():
    _, statuses, _ = follow(guarded(Wants(rate=BASAL)), [70.0, 66.0, 62.0, 58.0] + [math.nan] * 40)
    low = statuses == Status.SUSPENDED
    assert np.all(low[2:7])
    assert not np.any(low[-12:])


@pytest.mark.parametrize("word", [math.nan, math.inf, -1.0, 1e9])
def test_a_pump_that_talks_nonsense_is_taken_to_have_done_as_asked(word):
    guard = guarded(Wants(rate=25.0), OPEN)
    state = guard.init(observe(120.0))
    state, decision = step(guard, state, observe(120.0))
    state, _ = step(guard, state, observe(120.5, word))
    assert float(state.inner.delivered_mU_min) == float(decision.insulin_mU_min) == 25.0
    state = guard.init(observe(120.0, word))
    assert np.isfinite(state.doses.basal_mU_min)
    assert float(guarded(Wants(rate=25.0), basal_mU_min=22.0).init(observe(120.0, word)).doses.basal_mU_min) == 22.0


@pytest.mark.parametrize("nonsense", [math.nan, math.inf, -math.inf, -3.0, 1e7])
def test_a_setpoint_or_meal_that_cannot_be_is_not_handed_on(nonsense):
    guard = guarded(Wants(rate=BASAL))
    state = guard.init(observe(90.0, setpoint=nonsense))
    assert 20.0 <= float(state.inner.setpoint_mg_dl) <= 600.0
    state, _ = step(guard, guard.init(observe(90.0)), observe(90.0, carbs=40.0))
    assert float(state.inner.announced_carbs_g) == 40.0
    state, _ = step(guard, state, observe(90.0, setpoint=nonsense, carbs=nonsense))
    assert float(state.inner.setpoint_mg_dl) == SETPOINT
    assert float(state.inner.announced_carbs_g) == 0.0
