"""The guard: what it believes, when it falls back, what it allows, and that it is not there where it is not needed."""

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
    MPCTuning,
    Observation,
    Status,
    design_linear_mpc,
    design_open_loop,
    guarded,
)
from glucoloop.models.step_response import StepResponseModel
from glucoloop.pumps import DoseLimits

BASAL, SETPOINT, EVERY = 20.0, 81.0, 5.0
MODEL = StepResponseModel.from_impulse_response(-0.19 * np.exp(-np.arange(1, 61) / 18.0), EVERY)
MPC = design_linear_mpc(MODEL, MPCTuning(2, 12, 1.0, 1.0))
LIMITS = DoseLimits()
OPEN = GuardSettings(
    held_min=1000.0,
    error_mg_dl=0.0,
    always_basal=100.0,
    max_hour=100.0,
    max_on_board=100.0,
    low_mg_dl=0.0,
    ahead_min=0.0,
    fastest_mg_dl_min=1000.0,
)
"""A guard that lets everything pass that can be."""


@pytree
class Wants:
    """Asks for one rate, and remembers what it was shown."""

    rate: float
    sample_time_min: float = static(default=EVERY)

    def init(self, observation):
        return observation

    def step(self, state, observation):
        dose = jnp.full_like(observation.glucose_mg_dl, self.rate)
        return observation, Decision(insulin_mU_min=dose, status=jnp.zeros(dose.shape, int))


@pytree
class Fragile:
    """Its memory is lost at a reading above 200; it keeps a number for each person, a line, and one number for all."""

    sample_time_min: float = static(default=EVERY)

    def init(self, observation):
        return {"own": observation.glucose_mg_dl, "line": jnp.stack([observation.glucose_mg_dl] * 4), "shared": 1.0}

    def step(self, state, observation):
        lost = jnp.where(observation.glucose_mg_dl > 200.0, jnp.inf, 0.0)
        state = {"own": state["own"] + lost, "line": state["line"].at[2].add(-lost), "shared": state["shared"]}
        return state, Decision(
            insulin_mU_min=jnp.full_like(lost, BASAL + 1.0), status=jnp.zeros(observation.valid.shape, int)
        )


def observe(reading, delivered=BASAL, *, valid=True, setpoint=SETPOINT, carbs=0.0):
    return Observation(
        glucose_mg_dl=jnp.asarray(reading, float),
        valid=jnp.broadcast_to(jnp.asarray(valid), jnp.shape(reading)),
        setpoint_mg_dl=jnp.broadcast_to(jnp.asarray(setpoint, float), jnp.shape(reading)),
        delivered_mU_min=jnp.broadcast_to(jnp.asarray(delivered, float), jnp.shape(reading)),
        announced_carbs_g=jnp.broadcast_to(jnp.asarray(carbs, float), jnp.shape(reading)),
    )


@jax.jit
def step(controller, state, observation):
    return controller.step(state, observation)


def follow(controller, readings, *, start=BASAL, valid=None):
    """Doses, statuses and states over some readings, the pump doing as it is asked."""
    state, delivered = controller.init(observe(readings[0], start)), jnp.asarray(start)
    doses, statuses, states = [], [], []
    for k, reading in enumerate(readings):
        state, decision = step(controller, state, observe(reading, delivered, valid=valid is None or valid[k]))
        delivered = decision.insulin_mU_min
        doses.append(delivered)
        statuses.append(decision.status)
        states.append(state)
    return np.array(doses), np.array(statuses), states


# ------------------------------------------------------------------------------------------- nothing to do


def test_where_it_has_nothing_to_do_it_changes_no_bit():
    rng = np.random.default_rng(1)
    readings = SETPOINT + 25.0 + np.cumsum(rng.normal(0.3, 1.0, 60))
    guard = guarded(MPC, OPEN)
    doses, statuses, states = follow(guard, readings)
    plain, own, inner = follow(MPC, readings)
    np.testing.assert_array_equal(doses, plain)
    np.testing.assert_array_equal(statuses, own)
    jax.tree.map(np.testing.assert_array_equal, states[-1].inner, inner[-1])
    assert np.ptp(doses) > 20.0


def test_at_rest_the_usual_guard_has_nothing_to_do():
    readings = SETPOINT + np.random.default_rng(2).uniform(-0.5, 0.5, 40)
    doses, statuses, _ = follow(guarded(MPC), readings)
    np.testing.assert_array_equal(doses, follow(MPC, readings)[0])
    assert np.all(np.isin(statuses, [Status.OK, Status.SATURATED]))
    assert np.ptp(doses) > 0.1


# ------------------------------------------------------------------------------------------- readings


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
    assert all(float(state.given.doubted_mg_dl) == 0.0 for state in states[:2])
    assert np.all(doses[~np.array(believed)] <= BASAL)


def test_a_jump_is_put_down_to_the_sensor_and_a_jump_back_takes_it_away():
    guard = guarded(Wants(rate=60.0))
    quiet = [SETPOINT] * 3
    _, statuses, states = follow(guard, [*quiet, *([150.0 + 0.1 * k for k in range(12)])])
    doubted = [float(state.given.doubted_mg_dl) for state in states]
    assert doubted[3] == 0.0
    assert doubted[8] == pytest.approx(69.0, abs=8.0)
    assert statuses[-1] == Status.DOSE_LIMITED
    _, _, states = follow(guard, [150.0, 150.0, *[SETPOINT + 0.1 * k for k in range(8)], *[150.0] * 8])
    # Unseen glucose is thought to go back to the setpoint, so that the jump down counts for less than the jump up.
    assert float(states[-1].given.doubted_mg_dl) < 69.0 / 3.0


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
    np.testing.assert_allclose(doses[6:], [30.0, 30.0, 30.0, BASAL, BASAL, 30.0])
    assert statuses[6:].tolist() == [Status.OK] * 3 + [Status.DOSE_LIMITED] * 2 + [Status.OK]


# ------------------------------------------------------------------------------------------- gaps


def test_in_a_gap_the_controller_gets_at_most_basal_then_basal_is_given_then_a_part_of_it():
    limits = GuardSettings(gap_min=20.0, long_gap_min=60.0, reduced_fraction=0.4)
    readings = [150.0] * 3 + [math.nan] * 20 + [151.0, 150.0]
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


# ------------------------------------------------------------------------------------------- doses


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


# ------------------------------------------------------------------------------------------- what else is told


@pytest.mark.parametrize("word", [math.nan, math.inf, -1.0, 1e9])
def test_a_pump_that_talks_nonsense_is_taken_to_have_done_as_asked(word):
    guard = guarded(Wants(rate=25.0), OPEN)
    state = guard.init(observe(120.0))
    state, decision = step(guard, state, observe(120.0))
    state, _ = step(guard, state, observe(120.5, word))
    assert float(state.inner.delivered_mU_min) == float(decision.insulin_mU_min) == 25.0
    state = guard.init(observe(120.0, word))
    assert np.isfinite(state.given.basal_mU_min)
    assert float(guarded(Wants(rate=25.0), basal_mU_min=22.0).init(observe(120.0, word)).given.basal_mU_min) == 22.0


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


# ------------------------------------------------------------------------------------------- memory


def test_a_memory_that_is_no_longer_finite_is_restarted_for_that_person_alone():
    guard = guarded(Fragile(), OPEN)
    people = np.array([100.0, 100.0, 100.0])
    state = guard.init(observe(people))
    state, _ = step(guard, state, observe(people))
    state, _ = step(guard, state, observe(np.array([101.0, 240.0, 102.0])))
    state, decision = step(guard, state, observe(np.array([101.0, 140.0, 102.0])))
    assert decision.status.tolist() == [Status.OK, Status.RESTARTED, Status.OK]
    np.testing.assert_array_equal(decision.insulin_mU_min, [BASAL + 1.0, BASAL, BASAL + 1.0])
    np.testing.assert_array_equal(state.inner["own"], [100.0, 140.0, 100.0])
    np.testing.assert_array_equal(state.inner["line"][:, 1], 140.0)
    np.testing.assert_array_equal(state.inner["line"][:, 0], 100.0)
    assert float(state.inner["shared"]) == 1.0
    state, decision = step(guard, state, observe(np.array([101.0, 141.0, 102.0])))
    assert decision.status.tolist() == [Status.OK] * 3


NONSENSE = [math.nan, math.inf, -math.inf, 1e300, -1e300, -7.0, 0.5]


@pytest.mark.parametrize("word", range(len(jax.tree.leaves(guarded(MPC).init(observe(100.0))))))
def test_every_word_of_its_memory_may_be_lost(word):
    """The dose keeps its limits at once, and every number of the state is one again."""
    guard = guarded(MPC)
    state = follow(guard, [81.0, 90.0, 100.0, 110.0, 118.0])[2][-1]
    leaves, structure = jax.tree.flatten(state)
    for nonsense in NONSENSE:
        lost = jax.tree.unflatten(
            structure, [*leaves[:word], jnp.full_like(leaves[word], nonsense), *leaves[word + 1 :]]
        )
        delivered = 30.0
        for reading in (120.0, 122.0, 123.0):
            lost, decision = step(guard, lost, observe(reading, delivered))
            assert 0.0 <= decision.insulin_mU_min <= 66.9
            assert abs(decision.insulin_mU_min - delivered) <= 16.7 + 1e-9
            assert int(decision.status) in set(Status)
            delivered = float(decision.insulin_mU_min)
        for leaf in jax.tree.leaves(lost):
            assert np.all(np.isfinite(leaf))
            assert np.all(np.abs(leaf) <= 1e4)


def test_a_basal_rate_that_was_lost_is_found_again():
    for given_, basal in ((None, BASAL), (23.0, 23.0)):
        guard = guarded(Wants(rate=60.0), basal_mU_min=given_)
        state = guard.init(observe(90.0))
        for field in ("basal_mU_min", "per_basal"):
            lost = dataclasses.replace(state, given=dataclasses.replace(state.given, **{field: jnp.asarray(math.nan)}))
            healed, _ = step(guard, lost, observe(90.0))
            assert float(healed.given.basal_mU_min) == pytest.approx(basal, rel=1e-15)
            assert float(healed.given.per_basal) == pytest.approx(1.0 / basal, rel=1e-15)


def test_people_may_trail_or_be_mapped():
    rng = np.random.default_rng(3)
    readings = 100.0 + np.cumsum(rng.normal(0.0, 8.0, (40, 3)), axis=0)
    readings[rng.random(readings.shape) < 0.2] = np.nan
    guard = guarded(MPC)
    doses, statuses, _ = follow(guard, readings, start=np.full(3, BASAL))
    mapped = jax.vmap(lambda one: jax.lax.scan(_scanned, (guard.init(observe(one[0])), jnp.asarray(BASAL)), one)[1])
    by_map = mapped(jnp.asarray(readings.T))
    for i in range(3):
        alone, of_alone, _ = follow(guard, readings[:, i])
        np.testing.assert_allclose(doses[:, i], alone, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(statuses[:, i], of_alone)
        np.testing.assert_allclose(by_map[i], alone, rtol=1e-12, atol=1e-12)
    assert len(set(statuses.ravel().tolist())) > 4


def _scanned(carry, reading):
    state, delivered = carry
    state, decision = guarded(MPC).step(state, observe(reading, delivered))
    return (state, decision.insulin_mU_min), decision.insulin_mU_min


# ------------------------------------------------------------------------------------------- any controller at all


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
    for leaf in jax.tree.leaves((state.seen, state.given, state.setpoint_mg_dl, state.command_mU_min)):
        assert np.all(np.isfinite(leaf))


# ------------------------------------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("field", "value", "part"),
    [
        ("lowest_reading_mg_dl", -1.0, "a guard's lowest reading of -1 mg/dl is not possible; give 0 to 10000"),
        ("lowest_reading_mg_dl", 700.0, "are no range"),
        ("highest_reading_mg_dl", 10.0, "are no range"),
        ("fastest_mg_dl_min", 0.0, "above 0"),
        ("stuck_min", 0.0, "above 0"),
        ("gap_min", -5.0, "give 0 to 10000"),
        ("gap_min", 100.0, "less than its gap_min"),
        ("reduced_fraction", 1.5, "a guard's part of the basal rate of 1.5 is not possible; give 0 to 1"),
        ("max_hour", 0.5, "a guard's largest dose in an hour, in basal hours, of 0.5 is not possible; give 1 to 10000"),
        ("always_basal", 0.9, "give 1 to 10000"),
        ("fall_mg_dl", 0.0, "give 1 to 10000"),
        ("on_board_tau_min", 0.0, "give 1 to 10000"),
        ("error_mg_dl", 1e9, "give 0 to 10000"),
        ("low_mg_dl", math.nan, "a guard's bound on predicted glucose of nan mg/dl is not possible"),
        ("ahead_min", math.inf, "give 0 to 10000"),
        ("ahead_min", True, "give a number in min"),
        ("ahead_min", "20", "give a number in min, such as 20"),
    ],
)
def test_settings_out_of_bounds_are_refused(field, value, part):
    with pytest.raises(ValueError, match=part):
        GuardSettings(**{field: value})


@pytest.mark.parametrize("basal", [-1.0, 70.0, math.nan])
def test_a_basal_rate_outside_the_limits_is_refused(basal):
    with pytest.raises(ValueError, match=r"give one from 0 to 66.9 mU/min"):
        guarded(MPC, basal_mU_min=basal)


def test_a_basal_rate_is_handed_to_a_controller_that_asks_for_it():
    @pytree
    class Asks(Wants):
        basal: float = 0.0

        def with_basal(self, insulin_mU_min):
            return dataclasses.replace(self, basal=insulin_mU_min)

    guard = guarded(Asks(rate=1.0)).with_basal(30.0)
    assert guard.inner.basal == 30.0
    assert float(guard.init(observe(90.0, 25.0)).given.basal_mU_min) == 30.0
    guard = guarded(design_open_loop()).with_basal(30.0)
    assert float(guard.init(observe(90.0, 25.0)).given.basal_mU_min) == 30.0
    assert guard.sample_time_min == EVERY
