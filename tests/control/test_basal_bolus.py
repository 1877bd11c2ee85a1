"""Basal-bolus therapy: its formula in plain Python, insulin on board in closed form, and what it does with nonsense."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.control import BasalBolus, Observation, Status, guarded
from glucoloop.control.guard_settings import GuardSettings
from glucoloop.pumps import bolus_limits, dose_limits
from glucoloop.therapy import Profile

BASAL, TARGET, EVERY = 7.0, 110.0, 5.0
PERSON = Profile(basal_mU_min=BASAL, setpoint_mg_dl=TARGET)
CONTROLLER = BasalBolus(carb_ratio_g_U=10.0, correction_mg_dl_U=40.0).of_person(PERSON)
step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
ANY = st.one_of(st.floats(), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300]))


def observe(glucose=TARGET, *, carbs=0.0, bolus=0.0, delivered=BASAL, valid=True, setpoint=TARGET):
    return Observation(
        glucose_mg_dl=jnp.asarray(glucose, float),
        valid=jnp.asarray(valid),
        setpoint_mg_dl=jnp.asarray(setpoint, float),
        delivered_mU_min=jnp.asarray(delivered, float),
        announced_carbs_g=jnp.asarray(carbs, float),
        delivered_bolus_mU=jnp.asarray(bolus, float),
    )


FRESH = CONTROLLER.init(observe())


@settings(max_examples=60, deadline=None)
@given(glucose=st.floats(40.0, 170.0), carbs=st.floats(1.0, 150.0), on_board=st.floats(0.0, 3000.0))
def test_the_bolus_of_a_meal_is_that_of_the_formula(glucose, carbs, on_board):
    """Insulin on board is that of one that was given just now, so that its decay over a sample is known."""
    x = 4.744 * EVERY / 300.0
    left = on_board * (1.0 + x) * math.exp(-x)
    correction = (glucose - TARGET) / 40.0 * 1000.0
    if correction > 0.0:
        correction = max(correction - left, 0.0)
    expected = min(max(carbs / 10.0 * 1000.0 + correction, 0.0), 25_000.0)
    _, decision = step(CONTROLLER, FRESH, observe(glucose, carbs=carbs, bolus=on_board))
    assert float(decision.bolus_mU) == pytest.approx(expected, abs=1e-6)
    assert float(decision.insulin_mU_min) == BASAL


def test_insulin_on_board_is_that_of_two_depots():
    state, tau = FRESH, 300.0 / 4.744
    for k in range(60):
        state, _ = step(CONTROLLER, state, observe(bolus=4000.0 if k == 0 else 0.0))
        t = EVERY * (k + 1)
        left = 4000.0 * (1.0 + t / tau) * math.exp(-t / tau)
        assert float(state.first_mU + state.second_mU) == pytest.approx(left, rel=1e-12)
    assert left == pytest.approx(0.05 * 4000.0, rel=1e-3)  # after five hours 5 % are left


def test_high_glucose_is_corrected_without_a_meal_but_not_again_and_again():
    state, given = FRESH, []
    for _ in range(80):
        state, decision = step(CONTROLLER, state, observe(250.0, bolus=given[-1] if given else 0.0))
        given.append(float(decision.bolus_mU))
    assert np.flatnonzero(given).tolist() == [0, 36, 72]  # every 180 min
    assert given[0] == pytest.approx(140.0 / 40.0 * 1000.0)
    assert given[36] < 0.9 * given[0]  # less what is still on board


def test_low_glucose_takes_from_a_meal_and_a_missing_reading_does_not():
    low, missing = observe(70.0, carbs=40.0), observe(np.nan, carbs=40.0, valid=False)
    assert float(step(CONTROLLER, FRESH, low)[1].bolus_mU) == pytest.approx(3000.0)
    _, decision = step(CONTROLLER, FRESH, missing)
    assert float(decision.bolus_mU) == pytest.approx(4000.0)
    assert int(decision.status) == Status.READING_MISSING


def test_a_bolus_that_the_pump_did_not_give_is_not_on_board():
    state, decision = step(CONTROLLER, FRESH, observe(carbs=50.0))
    lost, _ = step(CONTROLLER, state, observe(bolus=0.0))
    silent, _ = step(CONTROLLER, state, observe(bolus=np.nan))
    assert float(lost.first_mU) == 0.0
    assert float(silent.first_mU) > 0.9 * float(decision.bolus_mU)


def test_by_the_rules_of_500_and_1800_the_ratios_follow_the_basal_rate():
    """Twice the basal rate is 20.16 U a day: 24.8 g and 89.3 mg/dl for a unit."""
    controller = BasalBolus().of_person(PERSON)
    assert float(controller.carbs_per_U) == pytest.approx(500.0 / 20.16)
    assert float(controller.fall_per_U) == pytest.approx(1800.0 / 20.16)
    other = controller.with_basal(jnp.asarray([3.5, 14.0]))
    np.testing.assert_allclose(other.carbs_per_U, [500.0 / 10.08, 500.0 / 40.32])
    assert np.all(np.isfinite(controller.with_basal(jnp.zeros(2)).carbs_per_U))


@settings(max_examples=100, deadline=None)
@given(numbers=st.tuples(ANY, ANY, ANY, ANY, ANY), valid=st.booleans())
def test_whatever_is_told_doses_are_possible_and_the_memory_is_sound(numbers, valid):
    glucose, carbs, bolus, delivered, setpoint = numbers
    told = observe(glucose, carbs=carbs, bolus=bolus, delivered=delivered, setpoint=setpoint, valid=valid)
    state, decision = step(CONTROLLER, FRESH, told)
    assert 0.0 <= float(decision.bolus_mU) <= 25_000.0
    assert 0.0 <= float(decision.insulin_mU_min) <= 66.9
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(state))


@pytest.mark.parametrize(
    ("given", "told"),
    [({"carb_ratio_g_U": -1.0}, "carb_ratio_g_U is -1 g per U; give"),
     ({"correction_mg_dl_U": -1.0}, "correction_mg_dl_U is -1"),
     ({"insulin_on_board_min": math.nan}, "insulin_on_board_min is nan"),
     ({"correction_every_min": -1.0}, "correction_every_min is -1"),
     ({"correction_above_mg_dl": math.inf}, "correction_above_mg_dl is inf")],
)  # fmt: skip
def test_impossible_settings_are_refused_with_a_sentence(given, told):
    with pytest.raises(ValueError, match=told):
        BasalBolus(**given)


def test_an_impossible_basal_rate_is_refused():
    with pytest.raises(ValueError, match="basal rate of 70"):
        BasalBolus().of_person(dataclasses.replace(PERSON, basal_mU_min=70.0))


# ------------------------------------------------------------------------------------------- guarded

WIDE = GuardSettings(max_hour=20.0, max_on_board=20.0)
UNDER_THE_SKIN = GuardSettings.for_route("subcutaneous")
GUARD = guarded(CONTROLLER, WIDE)


def test_a_guard_with_wide_caps_lets_a_meal_bolus_pass_to_the_bit():
    state = GUARD.init(observe())
    _, decision = step(GUARD, state, observe(carbs=40.0))
    assert float(decision.bolus_mU) == 4000.0
    assert int(decision.status) == Status.OK


def test_under_the_skin_a_right_bolus_passes_and_one_ten_times_larger_does_not():
    """By the rule of 500, with a total daily dose of 48 basal hours; the cap is ten basal hours on board."""
    guard = guarded(BasalBolus().of_person(PERSON), UNDER_THE_SKIN)
    state = guard.init(observe())
    for carbs in (50.0, 80.0, 100.0):
        _, decision = step(guard, state, observe(carbs=carbs))
        assert float(decision.bolus_mU) == pytest.approx(carbs * 48.0 / 500.0 * 60.0 * BASAL)
        assert int(decision.status) == Status.OK
    _, decision = step(guard, state, observe(carbs=500.0))
    assert float(decision.bolus_mU) == pytest.approx(10.0 * 60.0 * BASAL, rel=0.03)
    assert int(decision.status) == Status.DOSE_LIMITED


def test_a_route_that_does_not_exist_has_no_limits():
    assert GuardSettings.for_route("intravenous") == GuardSettings()
    with pytest.raises(ValueError, match="unknown route of insulin 'nasal'; the known ones are: intravenous, subcut"):
        GuardSettings.for_route("nasal")


def test_a_suspended_pump_gives_no_bolus():
    state = GUARD.init(observe(80.0))
    state, _ = step(GUARD, state, observe(72.0))
    state, decision = step(GUARD, state, observe(60.0, carbs=60.0))
    assert int(decision.status) == Status.SUSPENDED
    assert float(decision.bolus_mU) == 0.0
    assert float(decision.insulin_mU_min) == 0.0


def test_a_reading_that_is_not_believed_calls_for_no_correction_but_a_meal_is_covered():
    state = GUARD.init(observe())
    for glucose in (111.0, 112.0, 113.0):
        state, _ = step(GUARD, state, observe(glucose))
    state, jumped = step(GUARD, state, observe(390.0))
    assert int(jumped.status) == Status.READING_REJECTED
    assert float(jumped.bolus_mU) == 0.0
    _, meal = step(GUARD, state, observe(np.nan, carbs=40.0, valid=False))
    assert float(meal.bolus_mU) == pytest.approx(4000.0)


def test_no_bolus_once_nothing_was_believed_for_long():
    state = GUARD.init(observe())
    for _ in range(6):
        state, decision = step(GUARD, state, observe(np.nan, carbs=40.0, valid=False))
    assert int(decision.status) == Status.FALLBACK_BASAL
    assert float(decision.bolus_mU) == 0.0


EVENTS = st.lists(
    st.tuples(st.floats(40.0, 400.0), st.sampled_from([0.0, 0.0, 0.0, 20.0, 80.0, 1000.0]), st.booleans()),
    min_size=30,
    max_size=30,
)


@jax.jit
def follow(guard, glucose, carbs, valid):
    """Rates and boluses of a guard over a row of observations, the pump doing as it is asked."""

    def sample(carry, seen):
        state, delivered, bolus = carry
        told = observe(seen[0], carbs=seen[1], bolus=bolus, delivered=delivered, valid=seen[2])
        state, decision = guard.step(state, told)
        doses = decision.insulin_mU_min, decision.bolus_mU
        return (state, *doses), doses

    start = guard.init(observe()), jnp.asarray(BASAL), jnp.asarray(0.0)
    return jax.lax.scan(sample, start, (glucose, carbs, valid))[1]


@pytest.mark.long
@pytest.mark.parametrize(
    ("caps", "change"),
    [
        (GuardSettings(), 16.7),
        (UNDER_THE_SKIN, 16.7),
        (GuardSettings(max_hour=20.0, max_on_board=20.0), 1.0),
        (GuardSettings(max_hour=6.0, max_on_board=0.5), 4.0),
    ],
)
@settings(max_examples=60, deadline=None)
@given(events=EVENTS)
def test_all_insulin_keeps_the_caps_of_the_guard(caps, change, events):
    """Rate and bolus together, summed up here once more, for any readings and any announcements."""
    guard = guarded(CONTROLLER, caps, dose_limits(max_change_mU_min=change, allow_unusual=True))
    rates, boluses = follow(guard, *(jnp.asarray(column) for column in zip(*events, strict=True)))
    assert np.all(np.asarray(boluses) >= 0.0)
    on_board, hour, left = 0.0, [BASAL] * 12, math.exp(-EVERY / caps.on_board_tau_min)
    for total in np.asarray(rates) + np.asarray(boluses) / EVERY:
        on_board = max(left * on_board + (1.0 - left) * (total / BASAL - 1.0), 0.0)
        hour = [*hour[1:], max(total, BASAL)]
        assert on_board <= caps.max_on_board + 1e-9
        assert sum(hour) <= caps.max_hour * 12.0 * BASAL * (1.0 + 1e-9)


def test_a_guard_counts_the_larger_of_the_bolus_that_was_asked_for_and_that_was_reported():
    guard = guarded(CONTROLLER, GuardSettings(max_hour=5.0, max_on_board=5.0))
    state, first = step(guard, guard.init(observe()), observe(carbs=80.0))
    assert int(first.status) == Status.DOSE_LIMITED
    asked = float(first.bolus_mU)
    truthful, lost, silent, doubled = (
        float(step(guard, state, observe(carbs=80.0, bolus=bolus))[1].bolus_mU)
        for bolus in (asked, 0.0, np.nan, 2.0 * asked)
    )
    assert truthful == lost == silent < 0.3 * asked
    assert doubled == 0.0


def test_lost_words_of_the_memory_allow_no_more():
    state = GUARD.init(observe())
    for word in (np.nan, np.inf, -5.0, 1e300):
        broken = dataclasses.replace(state, bolus_mU=jnp.asarray(word))
        _, decision = step(GUARD, broken, observe(carbs=40.0, bolus=np.nan))
        assert 0.0 <= float(decision.bolus_mU) <= 4000.0


def test_a_largest_bolus_of_the_pump_is_never_passed():
    small = BasalBolus(carb_ratio_g_U=10.0).of_person(PERSON, bolus=bolus_limits(max_U=3.0))
    assert float(step(small, small.init(observe()), observe(carbs=100.0))[1].bolus_mU) == 3000.0
